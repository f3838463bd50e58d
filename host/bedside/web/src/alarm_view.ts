// The alarm signals on the page: the banner that flashes, the latched list, and the announcement for screen readers.

import { behindGone, clock, MARKS, ordered, spoken } from "./alarms";
import type { Device } from "./device";
import { h, setAttribute, setText, show } from "./dom";
import type { Alarm } from "./stream";

const NO_ALARMS = "No alarms";

/** The text that stands for an empty list of alarms: it says that there are none only if the state of every device is known. */
export function without(devices: readonly Pick<Device, "replay" | "state">[]): string {
  if (devices.length === 0) return "Waiting for the server";
  if (devices.every(({ replay }) => replay)) return "Replay: alarms are not evaluated";
  return devices.every(({ state }) => state !== null) ? NO_ALARMS : "Waiting for the device";
}

/** An alarm's text, whether its condition is gone, and whether it is acknowledged. */
export function inWords({ text, present, acknowledged }: Alarm): string {
  const notes = [...(present ? [] : ["gone"]), ...(acknowledged ? ["acknowledged"] : [])];
  return notes.length === 0 ? text : `${text} (${notes.join(", ")})`;
}

/** The banner in the page's head: the most urgent alarm and how many more there are. */
export class Banner {
  readonly element = h("div", { class: "banner", id: "banner" });
  private readonly mark = h("span", { class: "mark", "aria-hidden": "true" });
  private readonly text = h("span", { class: "banner-text" });
  /** The most urgent present alarm, if the one before it is gone. */
  private readonly behind = h("span", { class: "behind" });
  private readonly more = h("span", { class: "more" });
  /** Spoken at once by a screen reader when it changes. */
  private readonly live = h("div", { class: "spoken", role: "alert", "aria-live": "assertive", "aria-atomic": "true" });
  private said = "";

  constructor() {
    this.element.append(this.mark, h("div", { class: "banner-texts" }, this.text, this.behind), this.more, this.live);
  }

  /**
   * Shows the alarms, or the text `none`. It flashes, as the device's lamp does, while an alarm is listed; an acknowledgement removes
   * an alarm once its condition is gone.
   */
  update(alarms: readonly Alarm[], none = NO_ALARMS): void {
    const [first, ...rest] = ordered(alarms);
    const behind = behindGone(alarms);
    setAttribute(this.element, "data-priority", first?.priority ?? "none");
    setText(this.mark, first ? MARKS[first.priority] : "");
    setText(this.text, first ? inWords(first) : none);
    setText(this.behind, behind ? `Present: ${MARKS[behind.priority]} ${inWords(behind)}` : "");
    setText(this.more, rest.length > 0 ? `+${rest.length}` : "");
    this.say([first, behind].filter((alarm) => alarm != null).map(spoken).join(". "), none);
  }

  private say(text: string, none: string): void {
    if (text === this.said) return;
    this.said = text;
    setText(this.live, text === "" ? none : text);
  }
}

/** The list of a device's alarms with their times. */
export class AlarmList {
  readonly element = h("div", { class: "alarm-list" });
  private readonly list = h("ol", { "aria-label": "Alarms, the most urgent first" });
  private readonly none = h("p", { class: "quiet" });
  private known = "";

  constructor() {
    this.element.append(this.none, this.list);
  }

  update(alarms: readonly Alarm[], none = NO_ALARMS): void {
    setText(this.none, `${none}.`);
    const sorted = ordered(alarms);
    const now = JSON.stringify(sorted);
    if (now === this.known) return;
    this.known = now;
    show(this.none, sorted.length === 0);
    show(this.list, sorted.length > 0);
    this.list.replaceChildren(...sorted.map(item));
  }
}

function item(alarm: Alarm): HTMLElement {
  const notes = [alarm.priority, alarm.present ? "present" : "gone", alarm.acknowledged ? "acknowledged" : "not acknowledged"];
  return h(
    "li", { class: "alarm", "data-priority": alarm.priority, "data-present": String(alarm.present) },
    h("span", { class: "mark", "aria-hidden": "true" }, MARKS[alarm.priority]),
    h("span", { class: "alarm-text" }, alarm.text),
    h("span", { class: "alarm-note" }, `${notes.join(", ")}, ${alarm.since_ms === null ? "since an unknown time" : `since ${clock(alarm.since_ms)}`}`),
  );
}
