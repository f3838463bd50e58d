// The alarms of a device as the page shows them: order, words, marks and what sounds. Pure.
//
// Priority is shown in three ways, as IEC 60601-1-8 asks for: colour, mark and text.

import { words } from "./format";
import type { Unacknowledged } from "./pause";
import type { Alarm, Priority, State } from "./stream";
import { urgency } from "./tones";

/** Marks of the priorities. */
export const MARKS: Record<Priority, string> = { high: "!!!", medium: "!!", low: "!" };

/** Alarms that the page raises itself have ids with this prefix. */
export const OWN = "page:";

/** Sorts: urgent ones first, then present ones, then those not acknowledged, then the newest. */
export function ordered(alarms: readonly Alarm[]): Alarm[] {
  const rank = (alarm: Alarm) => [urgency(alarm.priority), Number(alarm.present), Number(!alarm.acknowledged), alarm.since_ms ?? 0];
  return [...alarms].sort((a, b) => {
    const [left, right] = [rank(a), rank(b)];
    for (let index = 0; index < left.length; index++) {
      const difference = (right[index] ?? 0) - (left[index] ?? 0);
      if (difference !== 0) return difference;
    }
    return a.id < b.id ? -1 : 1;
  });
}

/** The most urgent alarm; null if there is none. */
export function worst(alarms: readonly Alarm[]): Alarm | null {
  return ordered(alarms)[0] ?? null;
}

/** The most urgent alarm whose condition holds, if the most urgent of all is one whose condition is gone; else null. */
export function behindGone(alarms: readonly Alarm[]): Alarm | null {
  const [first, ...rest] = ordered(alarms);
  return first && !first.present ? (rest.find(({ present }) => present) ?? null) : null;
}

/** The alarms without an acknowledgement, by keys that name the device too. */
export function unacknowledged(device: number | "page", alarms: readonly Alarm[]): Unacknowledged[] {
  return alarms.filter(({ acknowledged }) => !acknowledged).map(({ id, priority }) => ({ key: `${device} ${id}`, priority }));
}

/** Whether the device has latched its safe state, which an acknowledgement leaves. */
export function inSafeState(state: State | null): boolean {
  return state?.safe_state === true;
}

/** The alarm that the page raises when the server or the samples are silent. It is urgent if the device may be ventilating. */
export function noData(ventilating: boolean, since_ms: number, text = "No data from the server"): Alarm {
  return { id: `${OWN}no-data`, text, priority: ventilating ? "high" : "medium", present: true, since_ms, acknowledged: false };
}

/** The reason why a device counts as not connected, in words. */
export function lacks({ missing }: Pick<State, "missing">): string {
  if (missing === "samples") return "No samples from the device";
  return missing === "answers" ? "No answers from the device" : "Device not connected";
}

function lostInWords(state: Pick<State, "missing" | "lost">): string {
  if (state.lost === null) return lacks(state);
  return state.missing === "samples" || state.missing === "answers" ? words(state.lost) : `${lacks(state)}: ${state.lost}`;
}

/** The alarm that the page raises when the server has lost the device. */
export function deviceLost(state: Pick<State, "missing" | "lost">, ventilating: boolean, since_ms: number): Alarm {
  return {
    id: `${OWN}device-lost`, text: lostInWords(state), priority: ventilating ? "high" : "medium",
    present: true, since_ms, acknowledged: false,
  };
}

/** The priority that sounds: of the device's sounder, or of an alarm of the page. */
export function sounding(state: State | null, own: readonly Alarm[]): Priority | null {
  const device = state !== null && state.audio.pause_left <= 0 ? state.audio.priority : null;
  const page = worst(own)?.priority ?? null;
  return urgency(page) > urgency(device) ? page : device;
}

/** One alarm in words, for a screen reader. */
export function spoken(alarm: Alarm): string {
  const gone = alarm.present ? "" : ", condition gone";
  const acknowledged = alarm.acknowledged ? ", acknowledged" : "";
  return `${alarm.priority} priority alarm: ${alarm.text}${gone}${acknowledged}`;
}

/** Time of day of a Unix time in ms. */
export function clock(time_ms: number): string {
  const date = new Date(time_ms);
  return [date.getHours(), date.getMinutes(), date.getSeconds()].map((part) => String(part).padStart(2, "0")).join(":");
}
