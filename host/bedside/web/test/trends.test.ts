// Trends: 72 hours in fixed memory, extremes kept.

import assert from "node:assert/strict";
import { test } from "node:test";
import { type Breath, decodeText } from "../src/stream";
import { BUCKET_MS, BUCKETS, Trends } from "../src/trends";

/** A history with the same values of the PIP in each minute. */
function history(minutes: number[], breaths: number, pip: number | null) {
  const column = minutes.map(() => pip);
  const decoded = decodeText(JSON.stringify({
    type: "history", device: 0, minutes, breaths: minutes.map(() => breaths), figures: { pip: { low: column, mean: column, high: column }, other: { low: column, mean: column, high: column } },
  }));
  assert.ok(decoded?.type === "history");
  return decoded;
}

function breath(pip: number | null): Breath {
  const decoded = decodeText(JSON.stringify({ type: "breath", device: 0, pip }));
  assert.ok(decoded?.type === "breath");
  return decoded;
}

const HOUR = 3_600_000;
const START = 1_700_000_000_000;

test("a bucket keeps the lowest, mean and highest value", () => {
  const trends = new Trends();
  for (const [index, pip] of [20, 30, 10, null].entries()) trends.add(START + index, breath(pip));
  const { low, mean, high } = trends.series("pip", 1);
  assert.deepEqual([low.at(-1), mean.at(-1), high.at(-1)], [10, 20, 30]);
  assert.equal(trends.series("error", 1).mean.at(-1), null);
});

test("100 hours of breaths leave the last 72 and one spike among them is not lost", () => {
  const trends = new Trends();
  const spike = START + 60 * HOUR;
  for (let time = START; time < START + 100 * HOUR; time += BUCKET_MS) trends.add(time, breath(time === spike ? 55 : 20));
  const { time, high } = trends.series("pip", 72, 500);
  assert.ok(time.length <= 501);
  const first = time[0] ?? 0;
  assert.ok(first * 1000 >= START + 28 * HOUR - 20 * 60_000 && first * 1000 <= START + 29 * HOUR);
  assert.equal(Math.max(...high.map((value) => value ?? 0)), 55);
  assert.equal(BUCKETS * BUCKET_MS, 72 * HOUR);
});

test("hours without breaths are a gap, and a clock that goes back does no harm", () => {
  const trends = new Trends();
  trends.add(START, breath(20));
  trends.add(START + 2 * HOUR, breath(30));
  trends.add(START + HOUR, breath(40));
  const { mean } = trends.series("pip", 8, 10_000);
  assert.equal(mean.filter((value) => value !== null).length, 2);
  trends.add(START + 500 * HOUR, breath(10));
  assert.deepEqual(trends.series("pip", 72).mean.filter((value) => value !== null), [10]);
});

test("the server's history fills the time before, and breaths that are here already are not doubled", () => {
  const trends = new Trends();
  const now = Math.floor(START / BUCKET_MS);
  for (const pip of [10, 30]) trends.add(START, breath(pip));
  trends.load(history([now - 120, now - 119, now], 3, 21));
  const { mean, high, time } = trends.series("pip", 3);
  assert.equal(time[0], ((now - 120) * BUCKET_MS) / 1000);
  assert.deepEqual([mean.filter((value) => value !== null), mean.at(-1), high.at(-1)], [[21, 21, 21], 21, 21]);
  trends.add(START, breath(25));
  assert.deepEqual([trends.series("pip", 1).mean.at(-1), trends.series("pip", 1).high.at(-1)], [22, 25]);
  // A server that has started again knows less than the page.
  trends.load(history([now], 1, 40));
  assert.equal(trends.series("pip", 1).mean.at(-1), 22);
});

test("a history that is too old or has unknown figures changes nothing, one of an empty page is all there is", () => {
  const trends = new Trends();
  const now = Math.floor(START / BUCKET_MS);
  trends.load(history([now - 1, now], 20, null));
  assert.deepEqual(trends.series("pip", 1).mean, [null, null]);
  trends.load(history([now - 2 * BUCKETS, now], 20, 33));
  assert.deepEqual(trends.series("pip", 72).mean.filter((value) => value !== null), [33]);
});

test("an empty trend is an empty line", () => {
  assert.deepEqual(new Trends().series("pip", 72), { time: [], low: [], mean: [], high: [] });
});
