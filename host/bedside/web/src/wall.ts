// The wall: all devices on one page, those with the worst alarm first; a click or Enter opens one.

import { inWords, without } from "./alarm_view";
import { MARKS, ordered, worst } from "./alarms";
import type { Device } from "./device";
import { colour, h, setAttribute, setText } from "./dom";
import { fixed, origin, words } from "./format";
import { Layer } from "./layer";
import { group } from "./pairs";
import { end } from "./scale";
import type { Figure } from "./stream";
import { urgency } from "./tones";

const FIGURES: [string, Figure, number][] = [["PIP", "pip", 1], ["PEEP", "peep", 1], ["VT", "tidal_volume", 0], ["Rate", "rate", 0], ["Error", "error", 2]];
/** Length of a card's sweep, s. */
const SECONDS = 6;

class Card {
  readonly element: HTMLElement;
  private readonly status = h("span", { class: "card-status" });
  private readonly alarm = h("div", { class: "card-alarm banner" });
  private readonly mark = h("span", { class: "mark", "aria-hidden": "true" });
  private readonly text = h("span", { class: "banner-text" });
  private readonly figures = FIGURES.map(() => h("dd", {}, "--"));
  private readonly graph = h("div", { class: "card-graph" });
  /** Says why the curve is not live. */
  private readonly cover = h("div", { class: "card-cover" });
  private readonly layer: Layer;
  private top = 0;

  constructor(readonly device: Device, open: () => void) {
    const name = device.info.name;
    this.layer = new Layer([
      { column: "target", colour: colour("--target"), width: 1 },
      { column: "pressure", colour: colour("--pressure"), width: 1.5 },
    ]);
    this.graph.append(this.layer.canvas, this.cover, h("span", { class: "origin" }, origin(device.info.kind)));
    this.alarm.append(this.mark, this.text);
    const opener = h("button", { type: "button", class: "card-open", onclick: open, "aria-label": `Open ${name}` }, h("span", { class: "card-name" }, name));
    const list = h("dl", {}, ...FIGURES.map(([label], index) => h("div", {}, h("dt", {}, label), this.figures[index] ?? "")));
    this.element = h("article", { class: "card", "aria-label": name }, h("header", {}, opener, this.status), this.alarm, this.graph, list);
    this.element.addEventListener("click", (event) => { if (!(event.target as Element).closest("button")) open(); });
  }

  update(now: number): void {
    const { state, breath } = this.device;
    const cover = this.device.cover();
    setText(this.cover, cover ?? "");
    this.element.classList.toggle("stale", cover !== null);
    this.element.classList.toggle("old", this.device.old(now));
    const alarm = worst(this.device.alarms());
    const others = ordered(this.device.alarms()).length - 1;
    setAttribute(this.alarm, "data-priority", alarm?.priority ?? "none");
    setText(this.mark, alarm ? MARKS[alarm.priority] : "");
    setText(this.text, alarm ? `${inWords(alarm)}${others > 0 ? ` +${others}` : ""}` : without([this.device]));
    setText(this.status, state ? `${words(state.mode)} · ${words(state.level)}` : "waiting");
    for (const [index, [, figure, digits]] of FIGURES.entries()) {
      const cell = this.figures[index];
      if (cell) setText(cell, fixed(breath?.[figure] ?? null, digits));
    }
  }

  draw(): void {
    const { ring, tick, state, reference } = this.device;
    this.top = end(this.top, 1.3 * (state?.settings.pip ?? 20), this.top === 0);
    this.layer.resize(this.graph.clientWidth, this.graph.clientHeight);
    this.layer.setRange(0, this.top);
    this.layer.setSweep({ seconds: SECONDS, tick });
    this.layer.update(ring, reference);
  }
}

export class Wall {
  readonly element = h("section", { class: "wall", "aria-label": "All devices" });
  private cards: Card[] = [];
  private groups: { cards: Card[]; element: HTMLElement }[] = [];
  private order = "";
  /** Whether a card is being pressed: it must not move away under the pointer, or another device would open, or none. */
  private pressed = false;

  constructor(private readonly open: (device: Device) => void) {
    this.element.addEventListener("pointerdown", () => { this.pressed = true; });
    for (const end of ["pointerup", "pointercancel", "blur"]) window.addEventListener(end, () => { this.pressed = false; });
  }

  describe(devices: readonly Device[]): void {
    this.cards = devices.map((device) => new Card(device, () => this.open(device)));
    this.groups = group(this.cards, (card) => card.device.info.name).map((cards) => {
      const pair = cards.length > 1;
      const element = h("div", { class: pair ? "group-of-cards pair" : "group-of-cards", role: "group", "aria-label": pair ? "PID beside learned controller" : "Device" });
      element.append(...cards.map((card) => card.element));
      return { cards, element };
    });
    this.order = "";
    this.pressed = false;
    this.sort();
  }

  update(now: number): void {
    for (const card of this.cards) card.update(now);
    this.sort();
  }

  draw(): void {
    if (this.element.offsetParent === null) return;
    for (const card of this.cards) card.draw();
  }

  /** Moves the groups with the worst alarms to the front; the focus stays where it is. */
  private sort(): void {
    const rank = (cards: Card[]) => Math.max(...cards.map(({ device }) => {
      const alarm = worst(device.alarms());
      return alarm === null ? 0 : 2 * urgency(alarm.priority) + Number(alarm.present);
    }));
    const sorted = this.groups.map((one, index) => ({ one, index, rank: rank(one.cards) })).sort((a, b) => b.rank - a.rank || a.index - b.index);
    const order = sorted.map(({ index }) => index).join();
    if (order === this.order || this.pressed) return;
    this.order = order;
    const focus = document.activeElement;
    this.element.replaceChildren(...sorted.map(({ one }) => one.element));
    if (focus instanceof HTMLElement && this.element.contains(focus)) focus.focus();
  }
}
