// The wire format: samples and texts decode, and malformed messages are refused.

import assert from "node:assert/strict";
import { test } from "node:test";
import { decodeSamples, decodeText, HEADER } from "../src/stream";
// @ts-expect-error The encoder is plain JavaScript.
import { encode } from "../dev/encode.mjs";

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
});

test("a breath's unknown figures are null", () => {
  const breath = decodeText('{"type":"breath","device":1,"pip":20.5,"leak":null,"estimated":true}');
  assert.ok(breath?.type === "breath");
  assert.deepEqual([breath.pip, breath.leak, breath.rate, breath.triggered], [20.5, null, null, false]);
});
