// Trends: 72 hours in fixed memory, extremes kept.

import assert from "node:assert/strict";
import { test } from "node:test";
import { type Breath, decodeText } from "../src/stream";
import { BUCKET_MS, BUCKETS, Trends } from "../src/trends";

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

test("an empty trend is an empty line", () => {
  assert.deepEqual(new Trends().series("pip", 72), { time: [], low: [], mean: [], high: [] });
});
