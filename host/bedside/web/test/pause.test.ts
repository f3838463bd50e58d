// The page's own audio pause: which alarms end it.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Pause } from "../src/pause";
import type { Priority } from "../src/stream";

const alarms = (...list: [string, Priority][]) => list.map(([key, priority]) => ({ key, priority }));

/** A pause of 120 s, begun at 0 while these alarms sound. */
function paused(...list: [string, Priority][]): Pause {
  const pause = new Pause();
  pause.step(0, alarms(...list));
  pause.begin(0, 120);
  assert.equal(pause.step(0, alarms(...list)), 120);
  return pause;
}

test("a pause ends by itself, and by hand", () => {
  const pause = paused(["0 leak", "low"]);
  assert.equal(pause.step(119_000, alarms(["0 leak", "low"])), 1);
  assert.equal(pause.step(121_000, alarms(["0 leak", "low"])), 0);
  const other = paused(["0 leak", "low"]);
  other.end();
  assert.equal(other.step(1000, alarms(["0 leak", "low"])), 0);
});

test("a new high alarm ends it, even beside a paused high one, and on another device", () => {
  for (const key of ["0 high-pressure", "1 disconnection"]) {
    const pause = paused(["0 disconnection", "high"]);
    assert.equal(pause.step(1000, alarms(["0 disconnection", "high"], [key, "high"])), 0, key);
  }
});

test("a new alarm below high ends it only above all that are paused", () => {
  assert.equal(paused(["0 leak", "low"]).step(1000, alarms(["0 leak", "low"], ["1 rate", "medium"])), 0);
  assert.equal(paused(["0 rate", "medium"]).step(1000, alarms(["0 rate", "medium"], ["1 rate", "medium"])), 119);
});

test("an alarm that becomes high, or comes back after its acknowledgement, is new", () => {
  assert.equal(paused(["0 page:no-data", "medium"]).step(1000, alarms(["0 page:no-data", "high"])), 0);
  const pause = paused(["0 disconnection", "high"], ["0 leak", "low"]);
  assert.equal(pause.step(1000, alarms(["0 leak", "low"])), 119);
  assert.equal(pause.step(2000, alarms(["0 disconnection", "high"], ["0 leak", "low"])), 0);
});

test("a pause without an alarm is none", () => {
  const pause = new Pause();
  pause.begin(0, 120);
  assert.equal(pause.step(0, []), 0);
});
