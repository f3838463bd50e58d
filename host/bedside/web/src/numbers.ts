// The panel of numbers: the figures of the last breath, the state of the control, and the losses of the line.

import { clock } from "./alarms";
import type { Device } from "./device";
import { h, setText, show } from "./dom";
import { count, fixed, plain, ratio, UNKNOWN, words } from "./format";
import { isPid } from "./pairs";
import type { Breath, Figure, State } from "./stream";

interface Tile {
  label: string;
  unit: string;
  /** The large text, and a small one below it. */
  text(breath: Breath | null, state: State | null, device: Device): string;
  below?(breath: Breath | null, state: State | null, device: Device): string;
  large?: boolean;
  estimated?: boolean;
  /** Text instead of a number: smaller letters over the whole width. */
  wide?: boolean;
  /** Whether it is shown for a device; always if left out. */
  only?(device: Device): boolean;
}

const figure = (name: Figure, digits: number) => (breath: Breath | null) => fixed(breath?.[name] ?? null, digits);
const set = (name: string) => (_: Breath | null, state: State | null) => {
  const value = state?.settings[name];
  return value === undefined ? "" : `set ${plain(value)}`;
};

const GROUPS: [string, string, Tile[]][] = [
  ["Pressure", "pressure", [
    { label: "PIP", unit: "cmH2O", text: figure("pip", 1), below: set("pip"), large: true },
    { label: "Plateau", unit: "cmH2O", text: figure("plateau", 1) },
    { label: "PEEP", unit: "cmH2O", text: figure("peep", 1), below: set("peep"), large: true },
  ]],
  ["Volume and rate", "volume", [
    { label: "Tidal volume", unit: "mL", text: figure("tidal_volume", 0), large: true, estimated: true },
    { label: "Minute volume", unit: "L/min", text: figure("minute_volume", 1), estimated: true },
    { label: "Rate", unit: "1/min", text: figure("rate", 0), below: rate, large: true },
    { label: "I:E", unit: "", text: (breath) => ratio(breath?.ie ?? null) },
  ]],
  ["Lung", "lung", [
    { label: "Resistance", unit: "cmH2O/(L/s)", text: figure("resistance", 0), estimated: true },
    { label: "Compliance", unit: "mL/cmH2O", text: figure("compliance", 0), estimated: true },
    { label: "Leak", unit: "L/min", text: figure("leak", 1), below: (breath) => (breath?.estimated && breath.leak === null ? "no flow sensor" : "") },
  ]],
  ["Control", "control", [
    { label: "Error", unit: "cmH2O", text: figure("error", 2) },
    { label: "Rise", unit: "ms", text: figure("rise_ms", 0) },
    { label: "Overshoot", unit: "cmH2O", text: figure("overshoot", 1) },
    { label: "Error, same lung", unit: "cmH2O", text: (_, __, device) => partner(device), wide: true, only: (device) => device.partner !== null },
    { label: "Controller", unit: "", text: (_, state) => state?.controller || UNKNOWN, wide: true },
    { label: "In command", unit: "", text: (_, state) => (state?.level ? words(state.level) : UNKNOWN), wide: true },
    { label: "Adaptation", unit: "", text: (_, state) => adaptation(state), below: (_, state) => (state?.adaptation ? `last breath: ${state.adaptation.last}` : ""), wide: true },
    { label: "Distrusted", unit: "", text: (_, state) => distrust(state), wide: true },
  ]],
  ["Tick and line", "line", [
    { label: "Mean tick", unit: "us", text: (_, state) => fixed(state?.ticks.mean_us ?? null, 1) },
    { label: "Longest", unit: "us", text: (_, state) => fixed(state?.ticks.worst_us ?? null, 0) },
    { label: "Bias", unit: "us", text: (_, state) => fixed(state?.ticks.bias_us ?? null, 2) },
    { label: "Jitter", unit: "us", text: (_, state) => fixed(state?.ticks.jitter_us ?? null, 2) },
    { label: "Missed", unit: "ticks", text: (_, state) => (state?.ticks.missed == null ? UNKNOWN : count(state.ticks.missed)) },
    { label: "Damaged", unit: "frames", text: (_, state) => (state ? count(state.line.corrupt) : UNKNOWN) },
    { label: "Lost", unit: "batches", text: (_, state) => (state ? count(state.line.lost_batches) : UNKNOWN) },
    { label: "Dropped", unit: "reports", text: (_, state) => (state ? count(state.line.dropped) : UNKNOWN) },
    { label: "Not sent to this page", unit: "samples", text: (_, __, device) => count(device.dropped), wide: true },
  ]],
];

/** Error of the other controller on the same lung: PID beside learned. */
function partner({ partner: other }: Device): string {
  if (other === null || other.old(performance.now())) return UNKNOWN;
  const controller = isPid(other.info.name) ? "PID" : "learned";
  return `${controller} ${fixed(other.breath?.error ?? null, 2)}`;
}

function rate(breath: Breath | null, state: State | null): string {
  const asked = breath?.rate_set ?? state?.settings.rate;
  const trigger = breath?.triggered ? ", patient" : "";
  return asked == null ? "" : `set ${plain(asked)}${trigger}`;
}

/** How far the learned controller has adapted to the patient. */
function adaptation(state: State | null): string {
  if (state?.adaptation == null) return UNKNOWN;
  const { breaths, of } = state.adaptation;
  return breaths < of ? `learning, ${breaths} of ${of} breaths` : "adapted";
}

function distrust(state: State | null): string {
  if (state === null) return UNKNOWN;
  // A server may name an alarm by its id.
  const text = (alarm: string) => state.alarms.find(({ id }) => id === alarm)?.text ?? words(alarm);
  return state.distrust.length === 0 ? "nothing" : state.distrust.map(text).join(", ");
}

export class Numbers {
  readonly element = h("section", { class: "numbers", "aria-label": "Numbers" });
  /** The time of the last breath, if its figures are not those of now. */
  private readonly age = h("p", { class: "age" });
  private readonly updates: ((device: Device) => void)[] = [];

  constructor() {
    this.element.append(this.age);
    for (const [name, hue, tiles] of GROUPS) {
      const list = h("dl", { class: `tiles tiles-${hue}` });
      for (const tile of tiles) list.append(this.tile(tile));
      this.element.append(h("div", { class: "group" }, h("h2", {}, name), list));
    }
  }

  update(device: Device, now: number): void {
    const old = device.old(now);
    this.element.classList.toggle("old", old);
    setText(this.age, old ? `Last breath at ${clock(device.breathTime)}` : "");
    for (const update of this.updates) update(device);
  }

  private tile(tile: Tile): HTMLElement {
    const [value, below] = [h("span", { class: "value" }, UNKNOWN), h("span", { class: "below" })];
    const label = h("dt", {}, tile.label);
    const unit = h("small", { class: "unit" }, tile.unit);
    const mark = h("small", { class: "estimated" }, "est.");
    if (tile.estimated) label.append(" ", mark);
    this.updates.push((device) => {
      setText(value, tile.text(device.breath, device.state, device));
      setText(below, tile.below?.(device.breath, device.state, device) ?? "");
      mark.hidden = device.breath !== null && !device.breath.estimated;
    });
    const kind = tile.wide ? "tile wide" : tile.large ? "tile large" : "tile";
    const element = h("div", { class: kind }, label, h("dd", {}, value, unit, below));
    if (tile.only) this.updates.push((device) => show(element, tile.only?.(device) ?? true));
    return element;
  }
}
