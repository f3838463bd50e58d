// Geometry of the sweep, and the ring of samples beneath it.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Reference } from "../src/reference";
import { Ring } from "../src/ring";
import type { Samples } from "../src/stream";
import { COLUMNS } from "../src/stream";
import { BAR, erased, firstShown, place, runs, sampleAt, shown } from "../src/sweep";

const SWEEP = { seconds: 6, tick: 0.001 };

/** Samples whose pressure is their tick; breaths of 3 s. */
function samples(tick: number, count: number): Samples {
  const column = () => Float32Array.from({ length: count }, (_, index) => tick + index);
  const phase = Uint8Array.from({ length: count }, (_, index) => ((tick + index) % 3000 < 1000 ? 0 : 2));
  const columns = Object.fromEntries(COLUMNS.map((name) => [name, column()])) as Samples["columns"];
  return { device: 0, count, dropped: 0, tick, time_ms: 0, columns, phase };
}

function ring(length: number, begin: number, count: number): Ring {
  const made = new Ring(length);
  for (let tick = begin; tick < begin + count; tick += 50) made.push(samples(tick, Math.min(50, begin + count - tick)));
  return made;
}

test("a tick has its place, pass after pass", () => {
  assert.equal(place(0, SWEEP), 0);
  assert.equal(place(1500, SWEEP), 0.25);
  assert.equal(place(61_500, SWEEP), 0.25);
});

test("the ring keeps the newest samples and knows their ticks", () => {
  const made = ring(1000, 500, 2500);
  assert.equal(made.end - made.oldest, 1000);
  assert.equal(made.newest, 2999);
  assert.equal(made.tickAt(made.oldest), 2000);
  assert.equal(made.at("pressure", made.find(2500)), 2500);
});

test("lost samples are counted and break the line; a restart forgets what was before", () => {
  const made = ring(4000, 0, 1000);
  made.push(samples(1100, 100));
  assert.equal(made.missing, 100);
  assert.deepEqual(runs(made, made.oldest, made.end, SWEEP).map(({ begin, end }) => end - begin), [1000, 100]);
  made.push(samples(0, 10));
  assert.equal(made.end - made.oldest, 10);
  assert.equal(made.missing, 100);
});

test("samples that pass while nothing is watched are not missing", () => {
  const made = ring(4000, 0, 100);
  made.resume();
  made.push(samples(5000, 100));
  assert.equal(made.missing, 0);
});

test("a line ends at the right edge and begins again at the left one", () => {
  const made = ring(8000, 5900, 200);
  assert.deepEqual(runs(made, made.oldest, made.end, SWEEP).map(({ begin, end }) => [made.tickAt(begin), made.tickAt(end - 1)]), [[5900, 5999], [6000, 6099]]);
});

test("the sweep shows everything but the bar, and the bar erases what it passes", () => {
  const made = ring(8000, 0, 7000);
  assert.equal(made.newest - made.tickAt(firstShown(made, SWEEP)) + 1, shown(SWEEP));
  assert.deepEqual(erased(0.5, 0.5), []);
  assert.deepEqual(erased(0.25, 0.5), [[0.25 + BAR, 0.5 + BAR]]);
  const [first, second] = erased(0.96, 0.98);
  assert.deepEqual([first?.[1], second?.[0]], [1, 0]);
});

test("the sample under a cursor is that of the last pass over it; under the bar there is none", () => {
  const made = ring(32_768, 0, 9000);
  const at = (part: number) => {
    const index = sampleAt(made, part, SWEEP);
    return index === null ? null : made.tickAt(index);
  };
  assert.equal(at(0.25), 7500);
  assert.equal(at(0.75), 4500);
  assert.equal(at(0.51), null);
  assert.equal(sampleAt(new Ring(10), 0.5, SWEEP), null);
});

test("the reference is the last complete breath and lies along later ones from their start", () => {
  const made = ring(32_768, 0, 10_000);
  const reference = Reference.take(made);
  assert.ok(reference);
  assert.equal(reference.length, 3000);
  assert.equal(reference.at("pressure", 10), 6010);
  const values = reference.along(made, { begin: made.find(9500), end: made.find(9600) }, "pressure");
  assert.deepEqual([values[0], values[99]], [6500, 6599]);
  assert.equal(Reference.take(ring(32_768, 0, 2000)), null);
});

test("a copy does not change with the ring", () => {
  const made = ring(1000, 0, 500);
  const copy = made.copy();
  made.push(samples(500, 900));
  assert.equal(copy.newest, 499);
  assert.equal(copy.at("pressure", copy.find(100)), 100);
});
