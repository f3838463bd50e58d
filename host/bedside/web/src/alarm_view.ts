// The alarm signals on the page: the banner that flashes, the latched list, and the announcement for screen readers.

import { clock, MARKS, ordered, spoken } from "./alarms";
import { h, setAttribute, setText, show } from "./dom";
import type { Alarm } from "./stream";

/** The banner in the page's head: the most urgent alarm and how many more there are. */
export class Banner {
  readonly element = h("div", { class: "banner", id: "banner" });
  private readonly mark = h("span", { class: "mark", "aria-hidden": "true" });
  private readonly text = h("span", { class: "banner-text" });
  private readonly more = h("span", { class: "more" });
  /** Spoken at once by a screen reader when it changes. */
  private readonly live = h("div", { class: "spoken", role: "alert", "aria-live": "assertive", "aria-atomic": "true" });
  private said = "";

  constructor() {
    this.element.append(this.mark, this.text, this.more, this.live);
  }

  update(alarms: readonly Alarm[], prefix = ""): void {
    const [first, ...rest] = ordered(alarms);
    setAttribute(this.element, "data-priority", first?.priority ?? "none");
    setAttribute(this.element, "data-gone", first && !first.present ? "true" : "false");
    setText(this.mark, first ? MARKS[first.priority] : "");
    setText(this.text, first ? `${prefix}${first.text}${first.present ? "" : " (gone)"}` : "No alarms");
    setText(this.more, rest.length > 0 ? `+${rest.length}` : "");
    this.say(first ? prefix + spoken(first) : "");
  }

  private say(text: string): void {
    if (text === this.said) return;
    this.said = text;
    setText(this.live, text === "" ? "No alarms" : text);
  }
}

/** The list of a device's alarms with their times. */
export class AlarmList {
  readonly element = h("div", { class: "alarm-list" });
  private readonly list = h("ol", { "aria-label": "Alarms, the most urgent first" });
  private readonly none = h("p", { class: "quiet" }, "No alarms.");
  private known = "";

  constructor() {
    this.element.append(this.none, this.list);
  }

  update(alarms: readonly Alarm[]): void {
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
    h("span", { class: "alarm-note" }, `${notes.join(", ")}, since ${clock(alarm.since_ms)}`),
  );
}
