// Typed settings, confirmations, pairs of names, numbers as text, scales and pauses.

import assert from "node:assert/strict";
import { test } from "node:test";
import { changes, large, steerers, typed } from "../src/confirm";
import { count, fixed, origin, plain, ratio, sentence, words } from "../src/format";
import { group, isPid } from "../src/pairs";
import { end, roundUp } from "../src/scale";
import { pause } from "../src/socket";
import type { Setting } from "../src/stream";

const PIP: Setting = { name: "pip", description: "", unit: "cmH2O", min: 5, max: 50, default: 20 };
const RATE: Setting = { name: "rate", description: "", unit: "1/min", min: 4, max: 80, default: 20 };

test("a value outside its bounds or not a number is refused with the bounds", () => {
  assert.deepEqual(typed(PIP, " 22,5 "), { value: 22.5 });
  for (const text of ["", "x", "NaN", "Infinity", "4.9", "51", "2 0", "--"]) {
    const result = typed(PIP, text);
    assert.ok("reason" in result, text);
    assert.match(result.reason, /5 to 50 cmH2O/);
  }
});

test("a bound itself is accepted as printed", () => {
  assert.deepEqual(typed({ ...PIP, min: Math.fround(0.2) }, "0.2"), { value: 0.2 });
});

test("only pressures that change by more than 5 cmH2O need a confirmation", () => {
  const both = [PIP, RATE];
  assert.deepEqual(large(both, { pip: 20, rate: 20 }, { pip: 25, rate: 60 }, 5), []);
  assert.deepEqual(large(both, { pip: 20, rate: 20 }, { pip: 25.1, rate: 20 }, 5), ["PIP from 20 to 25.1 cmH2O"]);
  assert.equal(large(both, { pip: 20, rate: 20 }, { pip: 14, rate: 20 }, 5).length, 1);
  assert.equal(large(both, {}, { pip: 20 }, 5).length, 1, "an unknown pressure counts as a large change");
});

test("control that another page or another program has is taken over with a confirmation only", () => {
  assert.deepEqual(steerers({ steered_by: null, lease: null }), []);
  assert.deepEqual(steerers({ steered_by: null, lease: "this server" }), []);
  assert.deepEqual(steerers({ steered_by: "a page", lease: "this server" }), ["a page"]);
  assert.deepEqual(steerers({ steered_by: null, lease: "anna@icu" }), ["anna@icu"]);
  assert.deepEqual(steerers(null), []);
});

test("the noise of a 32-bit float is no change", () => {
  assert.deepEqual(changes([PIP], { pip: Math.fround(20.1) }, { pip: 20.1 }), []);
  assert.equal(plain(Math.fround(0.4)), "0.4");
});

test("devices that differ only in the controller form a pair, the PID first", () => {
  const names = ["R 5 C 20, learned", "alone", "R 50 C 20 (PID)", "R 5 C 20, PID", "R 50 C 20 (learned)"];
  assert.deepEqual(group(names, (name) => name), [["R 5 C 20, PID", "R 5 C 20, learned"], ["alone"], ["R 50 C 20 (PID)", "R 50 C 20 (learned)"]]);
  assert.deepEqual(group(["R5C10 PID", "R5C10 adult", "R5C100 PID", "R5C100 adult"], (name) => name).length, 2);
  assert.deepEqual(group(["R5C20", "R5C20 PID"], (name) => name), [["R5C20 PID", "R5C20"]]);
  assert.deepEqual(group(["PID", "Bench"], (name) => name).length, 2, "a name without a lung has no pair");
  assert.deepEqual([isPid("R5C20 PID"), isPid("R5C20 adult")], [true, false]);
  assert.deepEqual(group(["a PID", "a pid", "a learned"], (name) => name).length, 3, "an ambiguous pair is none");
});

test("numbers are written as the field writes them", () => {
  assert.deepEqual([fixed(null, 1), fixed(Number.NaN, 1), fixed(-0.01, 1), fixed(123.4, 1)], ["--", "--", "0.0", "123"]);
  assert.deepEqual([ratio(2), ratio(0.5), ratio(null), ratio(0)], ["1:2.0", "2.0:1", "--", "--"]);
  assert.deepEqual([words("inspiratory_time"), words("pip"), words("PID alone"), words("reading-frozen"), count(1_234_567)], ["Inspiratory time", "PIP", "PID alone", "Reading frozen", "1 234 567"]);
});

test("an answer is a sentence, and a device that is not live has a mark", () => {
  assert.deepEqual([sentence("from the next breath on"), sentence("Applied.")], ["From the next breath on.", "Applied."]);
  assert.deepEqual(["recording", "simulated", "board", "hil"].map(origin), ["REPLAY", "SIMULATED", "", ""]);
});

test("a scale grows at once and shrinks only when it may", () => {
  assert.deepEqual([roundUp(25), roundUp(31), roundUp(9999)], [30, 40, 3000]);
  assert.deepEqual([end(30, 35, false), end(40, 12, false), end(40, 12, true)], [40, 40, 20]);
});

test("the pauses between attempts grow to five seconds", () => {
  const pauses = [0, 1, 2, 3, 4, 5, 6, 10].map((attempt) => pause(attempt, 0.5));
  assert.deepEqual(pauses, [250, 500, 1000, 2000, 4000, 5000, 5000, 5000]);
  assert.ok(pause(10, 1) < 6001);
});
