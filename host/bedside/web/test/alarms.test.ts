// Order and words of the alarms; the tones against what IEC 60601-1-8 asks for.

import assert from "node:assert/strict";
import { test } from "node:test";
import { behindGone, inSafeState, noData, ordered, sounding, spoken, worst } from "../src/alarms";
import { type Alarm, decodeText, type State } from "../src/stream";
import { HARMONICS, PATTERNS, pulses, repeat } from "../src/tones";

const alarm = (id: string, priority: Alarm["priority"], rest: Partial<Alarm> = {}): Alarm =>
  ({ id, text: id, priority, present: true, since_ms: 0, acknowledged: false, ...rest });

function state(priority: string | null, pause_left = 0): State {
  const decoded = decodeText(JSON.stringify({ type: "state", device: 0, audio: { priority, pause_left } }));
  assert.ok(decoded?.type === "state");
  return decoded;
}

test("the most urgent alarm comes first, then present, not acknowledged, newest", () => {
  const alarms = [
    alarm("low", "low"), alarm("gone", "high", { present: false, since_ms: 9 }), alarm("known", "high", { acknowledged: true, since_ms: 5 }),
    alarm("old", "high", { since_ms: 1 }), alarm("medium", "medium"), alarm("new", "high", { since_ms: 2 }),
  ];
  assert.deepEqual(ordered(alarms).map(({ id }) => id), ["new", "old", "known", "gone", "medium", "low"]);
  assert.equal(worst([]), null);
});

test("an audio pause silences the device's alarms, not those of the page", () => {
  assert.equal(sounding(state("high"), []), "high");
  assert.equal(sounding(state("high", 60), []), null);
  assert.equal(sounding(state("high", 60), [noData(false, 0)]), "medium");
  assert.equal(sounding(null, [noData(true, 0)]), "high");
});

test("a present alarm is shown behind a more urgent one that is gone", () => {
  const [gone, leak, rate] = [alarm("gone", "high", { present: false }), alarm("leak", "low"), alarm("rate", "medium")];
  assert.equal(behindGone([leak, gone, rate])?.id, "rate");
  assert.equal(behindGone([gone]), null);
  assert.equal(behindGone([alarm("pressure", "high"), rate]), null);
});

test("the safe state is told by the server, whatever its words for the mode", () => {
  const safe = (content: object) => {
    const decoded = decodeText(JSON.stringify({ type: "state", device: 0, mode: "safe state", ...content }));
    return decoded?.type === "state" && inSafeState(decoded);
  };
  assert.deepEqual([safe({ safe_state: true, mode: "vented" }), safe({ safe_state: false }), safe({}), inSafeState(null)], [true, false, false, false]);
});

test("an alarm is spoken with its priority, whether its condition is gone and whether it is acknowledged", () => {
  assert.equal(spoken(alarm("Leak", "low", { acknowledged: true })), "low priority alarm: Leak, acknowledged");
  assert.equal(spoken(alarm("Leak", "medium", { present: false })), "medium priority alarm: Leak, condition gone");
});

test("bursts have the pulses, lengths and intervals of the standard", () => {
  assert.deepEqual([pulses("high").length, pulses("medium").length, pulses("low").length], [10, 3, 2]);
  const length = (priority: "high" | "medium" | "low", shortest: number, longest: number) => {
    assert.ok(PATTERNS[priority].pulse >= shortest && PATTERNS[priority].pulse <= longest, priority);
  };
  length("high", 0.075, 0.2);
  length("medium", 0.125, 0.25);
  length("low", 0.125, 0.25);
  assert.ok(PATTERNS.high.interval >= 2.5 && PATTERNS.high.interval <= 15);
  assert.ok(PATTERNS.medium.interval >= 2.5 && PATTERNS.medium.interval <= 30);
  assert.ok(PATTERNS.low.interval >= 15);
  assert.ok(repeat("high") > (pulses("high").at(-1) ?? 0) + 4);
});

test("a tone has at least four harmonics from 300 to 4000 Hz over a fundamental of 150 to 1000 Hz", () => {
  for (const { pitch } of Object.values(PATTERNS)) {
    assert.ok(pitch >= 150 && pitch <= 1000);
    const peaks = HARMONICS.map((_, index) => pitch * (index + 1)).filter((hertz) => hertz >= 300 && hertz <= 4000);
    assert.ok(peaks.length >= 4);
  }
});
