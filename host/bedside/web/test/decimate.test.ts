// The decimation loses no spike and keeps the line.

import assert from "node:assert/strict";
import { test } from "node:test";
import { decimate } from "../src/decimate";

/** Lowest and highest value of each pixel column. */
function extremes(x: readonly number[], y: readonly number[]): Map<number, [number, number]> {
  const found = new Map<number, [number, number]>();
  for (const [index, at] of x.entries()) {
    const value = y[index] ?? Number.NaN;
    if (Number.isNaN(value)) continue;
    const [low, high] = found.get(Math.floor(at)) ?? [value, value];
    found.set(Math.floor(at), [Math.min(low, value), Math.max(high, value)]);
  }
  return found;
}

/** Numbers that look random and are the same in each run. */
function noise(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state * 1_103_515_245 + 12_345) % 2_147_483_648;
    return state / 2_147_483_648;
  };
}

test("every column keeps its lowest and highest value, whatever the samples", () => {
  for (let seed = 1; seed <= 50; seed++) {
    const next = noise(seed);
    const values = Array.from({ length: 3000 }, () => (next() < 0.01 ? 100 * next() : next()));
    const columns = 1 + Math.floor(700 * next());
    const x = values.map((_, index) => (index * columns) / values.length);
    const points = decimate(values.length, (index) => x[index] ?? 0, (index) => values[index] ?? 0);
    assert.deepEqual(extremes(points.x, points.y), extremes(x, values));
    assert.ok(points.x.length <= 4 * columns + 4);
  }
});

test("a spike of one sample among thirty thousand is in the picture", () => {
  const points = decimate(30_000, (index) => index / 50, (index) => (index === 17_321 ? 55 : 5));
  assert.ok(points.y.includes(55));
});

test("points keep the order of time, and the line its first and last sample", () => {
  const next = noise(7);
  const values = Array.from({ length: 1000 }, () => next());
  const points = decimate(values.length, (index) => index / 13, (index) => values[index] ?? 0);
  assert.ok(points.x.every((at, index) => index === 0 || at >= (points.x[index - 1] ?? 0)));
  assert.equal(points.y[0], values[0]);
  assert.equal(points.y.at(-1), values.at(-1));
});

test("an unknown value breaks the line once", () => {
  const values = [1, Number.NaN, Number.NaN, 2, 3];
  const points = decimate(values.length, (index) => 10 * index, (index) => values[index] ?? 0);
  assert.deepEqual(points.y, [1, Number.NaN, 2, 3]);
});

test("few samples per column pass unchanged", () => {
  const points = decimate(5, (index) => 3 * index, (index) => index * index);
  assert.deepEqual(points, { x: [0, 3, 6, 9, 12], y: [0, 1, 4, 9, 16] });
});
