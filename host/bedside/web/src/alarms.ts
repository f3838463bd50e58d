// The alarms of a device as the page shows them: order, words, marks and what sounds. Pure.
//
// Priority is shown in three ways, as IEC 60601-1-8 asks for: colour, mark and text.

import type { Alarm, Priority, State } from "./stream";
import { urgency } from "./tones";

/** Marks of the priorities. */
export const MARKS: Record<Priority, string> = { high: "!!!", medium: "!!", low: "!" };

/** Alarms that the page raises itself have ids with this prefix. */
export const OWN = "page:";

/** Sorts: urgent ones first, then present ones, then those not acknowledged, then the newest. */
export function ordered(alarms: readonly Alarm[]): Alarm[] {
  const rank = (alarm: Alarm) => [urgency(alarm.priority), Number(alarm.present), Number(!alarm.acknowledged), alarm.since_ms];
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

/** The alarm that the page raises when nothing arrives. It is urgent if the device may be ventilating. */
export function noData(ventilating: boolean, since_ms: number): Alarm {
  return {
    id: `${OWN}no-data`, text: "No data from the server", priority: ventilating ? "high" : "medium",
    present: true, since_ms, acknowledged: false,
  };
}

/** The alarm that the page raises when the server has lost the device. */
export function deviceLost(reason: string | null, ventilating: boolean, since_ms: number): Alarm {
  return {
    id: `${OWN}device-lost`, text: reason === null ? "Device not connected" : `Device not connected: ${reason}`,
    priority: ventilating ? "high" : "medium", present: true, since_ms, acknowledged: false,
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
  return `${alarm.priority} priority alarm: ${alarm.text}${gone}`;
}

/** Time of day of a Unix time in ms. */
export function clock(time_ms: number): string {
  const date = new Date(time_ms);
  return [date.getHours(), date.getMinutes(), date.getSeconds()].map((part) => String(part).padStart(2, "0")).join(":");
}
