// The wire format: samples and texts decode, and malformed messages are refused.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { decodeSamples, decodeText, HEADER } from "../src/stream";
// @ts-expect-error The encoder is plain JavaScript.
import { encode } from "../dev/encode.mjs";

/** Bytes of the server: a test of ../../src/stream/frame.rs writes the same. */
const BYTES = Buffer.from(readFileSync(new URL("../test/samples.hex", import.meta.url), "utf8").replace(/\s/g, ""), "hex");

test("the bytes of the server decode", () => {
  const samples = decodeSamples(new Uint8Array(BYTES).buffer);
  assert.ok(samples);
  const { device, count, dropped, tick, time_ms, columns, phase } = samples;
  assert.deepEqual([device, count, dropped, tick, time_ms], [3, 3, 9, 2 ** 40 + 5, 1_700_000_000_000.5]);
  assert.deepEqual(Object.values(columns).map((column) => [...column]), [
    [1.5, -11, 21], [20, 12.25, 22], [30, 13, 23], [0, 100, 100], [5.25, Number.NaN, 25], [0.5, -16, 26], [6, 250, 27],
  ]);
  assert.deepEqual([...phase], [0, 1, 2]);
});

test("the fake server's encoder gives the server's bytes", () => {
  const rows = [[1.5, 20, 30, 0, 5.25, 0.5, 6, 0], [-11, 12.25, 13, 100, Number.NaN, -16, 250, 1], [21, 22, 23, 100, 25, 26, 27, 2]];
  const bytes = encode(3, 2 ** 40 + 5, rows, 9, 1_700_000_000_000.5) as Uint8Array;
  assert.deepEqual([...bytes], [...BYTES]);
});

const SAMPLES = [[1, 2, 3, 4, 5, 6, 7, 0], [11, 12, 13, 14, Number.NaN, 16, 17, 2], [21, 22, 23, 24, 25, 26, 27, 1]];
const message = () => (encode(3, 2 ** 40 + 5, SAMPLES, 9) as Uint8Array).buffer as ArrayBuffer;

test("samples decode column by column", () => {
  const samples = decodeSamples(message());
  assert.ok(samples);
  assert.deepEqual([samples.device, samples.count, samples.dropped, samples.tick], [3, 3, 9, 2 ** 40 + 5]);
  assert.deepEqual([...samples.columns.pressure], [1, 11, 21]);
  assert.deepEqual([...samples.columns.learned], [5, Number.NaN, 25]);
  assert.deepEqual([...samples.columns.volume], [7, 17, 27]);
  assert.deepEqual([...samples.phase], [0, 2, 1]);
});

test("samples cut short, of another kind or with too long a tail are refused", () => {
  const whole = message();
  for (let length = 0; length < HEADER + 29 * 3; length++) assert.equal(decodeSamples(whole.slice(0, length)), null);
  const other = whole.slice(0);
  new Uint8Array(other)[0] = 2;
  assert.equal(decodeSamples(other), null);
  assert.equal(decodeSamples(new ArrayBuffer(whole.byteLength + 8)), null);
});

test("malformed texts and unknown types are refused, never thrown", () => {
  for (const text of ["", "{", "[]", "null", "7", '"state"', '{"type":"other"}', '{"type":"state"}', '{"type":"breath","device":"x"}']) {
    assert.equal(decodeText(text), null, text);
  }
});

test("a state without its parts decodes to unknown values", () => {
  const state = decodeText('{"type":"state","device":1,"alarms":[{"id":"x"}]}');
  assert.ok(state?.type === "state");
  assert.equal(state.connected, false);
  assert.deepEqual(state.audio, { priority: null, pause_left: 0 });
  assert.equal(state.alarms[0]?.priority, "high");
  assert.equal(state.adaptation, null);
});

test("the samples that a recording has lost are counted, none if the server does not tell", () => {
  const lost = (recording: object) => {
    const state = decodeText(JSON.stringify({ type: "state", device: 1, recording: { file: "a.parquet", samples: 5, ...recording } }));
    return state?.type === "state" ? state.recording?.lost : undefined;
  };
  assert.deepEqual([lost({ lost: 7 }), lost({})], [7, 0]);
});

test("an adaptation is whole or unknown", () => {
  const adaptation = (value: unknown) => {
    const state = decodeText(JSON.stringify({ type: "state", device: 1, adaptation: value }));
    return state?.type === "state" ? state.adaptation : undefined;
  };
  assert.deepEqual(adaptation({ breaths: 2, of: 4, last: "adopted" }), { breaths: 2, of: 4, last: "adopted" });
  for (const wrong of [null, 3, { breaths: 2 }, { of: 4, last: "adopted" }]) assert.equal(adaptation(wrong), null);
});

test("a history with columns of unequal length is refused", () => {
  const course = { low: [1, 2], mean: [1, null], high: [1, 2] };
  const text = (change: object) => JSON.stringify({ type: "history", device: 0, minutes: [5, 6], breaths: [1, 1], figures: { pip: course }, ...change });
  assert.equal(decodeText(text({}))?.type, "history");
  for (const change of [{ minutes: [5] }, { breaths: [1, "x"] }, { figures: { pip: { ...course, low: [1] } } }, { figures: { pip: 7 } }]) {
    assert.equal(decodeText(text(change)), null);
  }
});

test("a breath's unknown figures are null", () => {
  const breath = decodeText('{"type":"breath","device":1,"pip":20.5,"leak":null,"estimated":true}');
  assert.ok(breath?.type === "breath");
  assert.deepEqual([breath.pip, breath.leak, breath.rate, breath.triggered], [20.5, null, null, false]);
});

test("margins are read, and what is not known of them is null", () => {
  const chart = { title: "Magnitude", x_label: "frequency, Hz", y_label: "magnitude", log_x: true, log_y: true, square: null, curves: [{ name: "loop", role: "", dashed: false, x: [1, null, 3], y: [5, 6, null] }] };
  const margin = { name: "Ms", unit: "", value: null, unstated: "not enough coherence", low: 1.2, high: null, decimals: 2, robust: "at most 2", keeps: null };
  const read = decodeText(JSON.stringify({ type: "margins", device: 3, time_ms: 5, refused: null, controller: "PID", amplitude: 10, margins: [margin], remarks: ["one"], advice: [{ cause: "gain", text: "lower" }], charts: [chart] }));
  assert.ok(read?.type === "margins");
  assert.deepEqual(read.margins, [margin]);
  assert.deepEqual([read.advice, read.remarks, read.charts[0]?.square], [[{ cause: "gain", text: "lower" }], ["one"], null]);
  // A point without a place is left out, one without a value is a gap.
  assert.deepEqual(read.charts[0]?.curves[0], { name: "loop", role: "", dashed: false, x: [1, 3], y: [5, null] });
  const nothing = decodeText('{"type":"margins","device":0,"refused":"an alarm","charts":[{"square":[-2.5,1.5]}]}');
  assert.ok(nothing?.type === "margins" && nothing.refused === "an alarm");
  assert.deepEqual(nothing.charts[0]?.square, [-2.5, 1.5]);
});
