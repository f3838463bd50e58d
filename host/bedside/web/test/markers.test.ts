// Markers: those that the sweep shows stand at the place of their tick.

import assert from "node:assert/strict";
import { test } from "node:test";
import { visible } from "../src/markers";
import { share } from "../src/verdict_view";

test("a marker is shown from its tick until the erase bar reaches it", () => {
  const sweep = { seconds: 6, tick: 0.001 };
  const markers = [{ tick: 3000, text: "here", time_ms: 0 }];
  const shown = (newest: number, oldest = 0) => visible(markers, newest, oldest, sweep);
  assert.deepEqual(shown(2999), []);
  assert.deepEqual(shown(3000), [{ at: 0.5, text: "here" }]);
  assert.equal(shown(3000 + 5840).length, 1);
  assert.equal(shown(3000 + 5860).length, 0);
  assert.equal(shown(4000, 3500).length, 0, "the samples there are of before a restart");
  assert.equal(visible(markers, Number.NaN, Number.POSITIVE_INFINITY, sweep).length, 0);
});

test("the share of violating breaths has a digit more when it is small", () => {
  assert.equal(share({ violating: 3, breaths: 1200 }), "3 of 1 200 judged breaths (0.3 %) violate a limit.");
  assert.equal(share({ violating: 10, breaths: 40 }), "10 of 40 judged breaths (25 %) violate a limit.");
  assert.equal(share({ violating: 0, breaths: 40 }), "0 of 40 judged breaths (0 %) violate a limit.");
});
