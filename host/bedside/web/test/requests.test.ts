// Requests: the page waits for an answer at least as long as the server waits for a device.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Requests } from "../src/requests";
import type { Answer } from "../src/stream";

test("a request is given up only after the server has asked the device four times, 1.5 s each", async ({ mock }) => {
  mock.timers.enable({ apis: ["setTimeout"] });
  const requests = new Requests(() => true);
  let answer: Answer | null = null;
  requests.ask("start", 0).then((one) => { answer = one; });
  mock.timers.tick(4 * 1_500 + 1_000);
  await Promise.resolve();
  assert.equal(answer, null);
  mock.timers.tick(1_500);
  await Promise.resolve();
  assert.match((answer as Answer | null)?.text ?? "", /^The server has not answered/);
});
