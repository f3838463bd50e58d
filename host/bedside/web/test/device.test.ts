// Silence of a device: samples and states are judged apart.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Device, SILENCE_MS } from "../src/device";
import { type Breath, decodeSamples, decodeText, type Samples, type State } from "../src/stream";
// @ts-expect-error The encoder is plain JavaScript.
import { encode } from "../dev/encode.mjs";

function state(content: object): State {
  const decoded = decodeText(JSON.stringify({ type: "state", device: 0, connected: true, mode: "ventilating", ventilating: true, ...content }));
  assert.ok(decoded?.type === "state");
  return decoded;
}

/** A sample. */
function decoded(tick = 0): Samples {
  const samples = decodeSamples((encode(0, tick, [[1, 2, 3, 0, 5, 6, 7, 0]]) as Uint8Array).buffer as ArrayBuffer);
  assert.ok(samples);
  return samples;
}

const info = { id: 0, name: "Bench", kind: "board", period_us: 1000 };

/** A watched device at a time from which on only these states come, every 100 ms; its own alarms after 1.1 s. */
function afterASecond(device: Device, content: object): { silent: boolean; texts: string[]; priorities: string[] } {
  const begin = performance.now();
  device.watch(true);
  let silent = false;
  for (let at = 0; at <= SILENCE_MS + 200; at += 100) {
    device.takeState(state(content), begin + at);
    silent = device.silent(begin + at, 0);
  }
  const own = device.own();
  return { silent, texts: own.map(({ text }) => text), priorities: own.map(({ priority }) => priority) };
}

test("states do not hide missing samples of a device that ventilates", () => {
  assert.deepEqual(afterASecond(new Device(info), {}), { silent: true, texts: ["No samples from the device"], priorities: ["high"] });
  assert.equal(afterASecond(new Device(info), { connected: false, missing: "answers", lost: "x" }).silent, true);
});

test("in standby, without a device, and in the pause of a replay there are no samples", () => {
  assert.equal(afterASecond(new Device(info), { mode: "standby", ventilating: false }).silent, false);
  assert.deepEqual(afterASecond(new Device(info), { connected: false, missing: "line", lost: "the port is gone" }), {
    silent: false, texts: ["Device not connected: the port is gone"], priorities: ["high"],
  });
  assert.equal(afterASecond(new Device({ ...info, kind: "recording" }), {}).silent, false);
});

test("a device whose mode is not known may be ventilating", () => {
  const lost = { connected: false, missing: "answers", lost: "waiting for the device's first answer", ventilating: false };
  assert.deepEqual(afterASecond(new Device(info), { ...lost, mode: "" }).priorities, ["high"]);
  assert.deepEqual(afterASecond(new Device(info), { ...lost, mode: "standby" }).priorities, ["medium"]);
});

test("there is one limit, within a second, for all devices, and samples do not hide that states are missing", () => {
  const [standby, recording] = [state({ mode: "standby", ventilating: false }), { ...info, kind: "recording" }];
  for (const watched of [true, false]) {
    for (const device of [new Device(info), new Device(recording)]) {
      for (const one of [standby, state({})]) {
        const begin = performance.now();
        device.watch(watched);
        device.takeState(one, begin);
        device.takeSamples(decoded(), begin + 800);
        assert.deepEqual([device.silent(begin + 850, 0), device.silent(begin + 950, 0)], [false, true]);
        assert.deepEqual(device.own().map(({ text }) => text), ["No data from the server"]);
      }
    }
  }
});

test("samples are not late as soon as ventilation starts", () => {
  const device = new Device(info);
  const begin = performance.now();
  device.watch(true);
  device.takeState(state({ mode: "standby", ventilating: false }), begin + 60_000);
  device.takeState(state({}), begin + 60_500);
  for (const at of [61_000, 61_500]) device.takeState(state({}), begin + at);
  assert.equal(device.silent(begin + 61_300, 0), false);
  assert.equal(device.silent(begin + 61_500, 0), true);
});

test("a breath is in the trends at its own time", () => {
  const device = new Device(info);
  const minute = 29_000_000;
  for (const at of [0, 1, 2]) {
    const breath = decodeText(JSON.stringify({ type: "breath", device: 0, pip: 20 + at, time_ms: (minute + at) * 60_000 }));
    assert.ok(breath?.type === "breath");
    device.takeBreath(breath, 0);
  }
  assert.deepEqual(device.trends.series("pip", 1).mean, [20, 21, 22]);
});

test("figures are old if nothing arrives, without ventilation, and when breaths fail to come", () => {
  const device = new Device(info);
  const settings = { rate: 20 };
  const begin = performance.now();
  const old = (at: number, content: object = {}, connection = 0) => {
    device.takeState(state({ settings, ...content }), begin + at);
    device.silent(begin + at, connection);
    return device.old(begin + at);
  };
  const breath = (at: number) => device.takeBreath({ ...(decodeText('{"type":"breath","device":0,"rate_set":20}') as Breath) }, begin + at);
  assert.equal(old(0), false, "there is none yet");
  breath(0);
  assert.deepEqual([old(5_900), old(6_100)], [false, true]);
  breath(7_000);
  assert.deepEqual([old(7_100), old(7_200, { mode: "standby", ventilating: false }), old(7_300, { connected: false, missing: "line" })], [false, true, true]);
  assert.equal(old(7_400, { connected: false, missing: "answers" }), false, "samples may arrive all the same");
  assert.deepEqual([old(7_500, {}, 1_000), old(7_600)], [true, false]);
  assert.equal(old(20_000, { settings: { rate: 5 } }), false, "the next breath may be the first one at a lower rate");
});

/** Takes an event of a kind at a time of the server, ms. */
function event(device: Device, kind: string, time_ms: number, tick: number | null = null): void {
  device.takeEvent({ type: "event", device: 0, time_ms, kind, text: kind, tick });
}

test("markers and the breath of before a restart are forgotten, those of after it stay", () => {
  const device = new Device(info);
  device.takeBreath({ ...(decodeText('{"type":"breath","device":0,"time_ms":1500}') as Breath) }, 0);
  for (const [kind, at, tick] of [["marker", 1_000, 70_000], ["restarted", 2_000, null], ["marker", 3_000, 900]] as const) event(device, kind, at, tick);
  assert.deepEqual(device.markers.map(({ tick }) => tick), [900]);
  assert.equal(device.breath, null);
  // The page may see the restart in the samples before the server tells it.
  device.takeBreath({ ...(decodeText('{"type":"breath","device":0,"time_ms":3500}') as Breath) }, 0);
  event(device, "restarted", 2_500);
  assert.deepEqual(device.markers.map(({ tick }) => tick), [900]);
  assert.notEqual(device.breath, null);
});

test("markers are forgotten when the ticks begin again, but not those of a recording", () => {
  for (const [kind, kept] of [["board", 0], ["recording", 1]] as const) {
    const device = new Device({ ...info, kind });
    device.takeSamples(decoded(70_000), 0);
    event(device, "marker", Date.now() - 1_000, 70_000);
    device.takeSamples(decoded(0), 0);
    assert.equal(device.markers.length, kept, kind);
  }
});
