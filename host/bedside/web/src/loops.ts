// Loops of the last breath, with the breath before it and the reference behind: volume over pressure, and flow over volume.

import type { Device } from "./device";
import { colour, h } from "./dom";
import { Frame } from "./frame";
import type { Reference } from "./reference";
import type { Ring } from "./ring";
import { end } from "./scale";

/** Interval between two pictures, ms. */
const EVERY = 100;
/** Most points of a loop; more samples are thinned. */
const POINTS = 1500;

type Axis = "pressure" | "flow" | "volume";
type Value = (axis: Axis, age: number) => number;

class Loop {
  readonly host: HTMLElement;
  private readonly canvas = document.createElement("canvas");
  private readonly frame: Frame;
  private ends: [number, number, number, number] = [0, 0, 0, 0];

  constructor(name: string, private readonly x: Axis, private readonly y: Axis, units: [string, string], private readonly hue: string) {
    this.canvas.className = "layer";
    this.host = h("div", { class: "loop", role: "img", "aria-label": `${name} loop` });
    this.frame = new Frame(this.host, { label: units[1], bottom: "", space: 30 }, this.canvas);
    this.host.prepend(h("div", { class: "loop-name", "aria-hidden": "true" }, name, h("span", { class: "unit" }, `${units[1]} over ${units[0]}`), h("span", { class: "estimated" }, "estimated")));
  }

  fit(width: number, height: number): void {
    if (width < 80 || height < 80) return;
    this.frame.resize(width, height);
  }

  /** Gives the canvas the size of the area between the axes, which uPlot sets only after the call that resizes it. */
  private match(): void {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [inner, tall] = this.frame.inner;
    if (this.canvas.width === Math.round(inner * ratio) && this.canvas.height === Math.round(tall * ratio)) return;
    this.canvas.width = Math.round(inner * ratio);
    this.canvas.height = Math.round(tall * ratio);
    this.canvas.style.width = `${inner}px`;
    this.canvas.style.height = `${tall}px`;
    this.canvas.getContext("2d")?.setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  draw(breaths: { value: Value; length: number; colour: string; width: number }[], fresh: boolean): void {
    const context = this.canvas.getContext("2d");
    if (context === null) return;
    this.match();
    this.rescale(breaths, fresh);
    const [width, height] = this.frame.inner;
    const [left, right, low, high] = this.ends;
    context.clearRect(0, 0, width, height);
    for (const { value, length, colour: hue, width: line } of breaths) {
      context.beginPath();
      const step = Math.max(1, Math.floor(length / POINTS));
      for (let age = 0; age < length; age += step) {
        context.lineTo(((value(this.x, age) - left) / (right - left)) * width, (1 - (value(this.y, age) - low) / (high - low)) * height);
      }
      context.strokeStyle = hue || this.hue;
      context.lineWidth = line;
      context.stroke();
    }
  }

  private rescale(breaths: { value: Value; length: number }[], fresh: boolean): void {
    const reach = (axis: Axis): [number, number] => {
      let [low, high] = [0, 0];
      for (const { value, length } of breaths) {
        for (let age = 0; age < length; age += 5) {
          const one = value(axis, age);
          if (one < low) low = one;
          if (one > high) high = one;
        }
      }
      return [low, high];
    };
    const ends = (axis: Axis, low: number, high: number): [number, number] => {
      const [least, most] = reach(axis);
      const top = end(high, 1.1 * most, fresh);
      return [axis === "flow" ? -end(-low, Math.max(-1.1 * least, 1), fresh) : 0, Math.max(top, 1)];
    };
    this.ends = [...ends(this.x, this.ends[0], this.ends[1]), ...ends(this.y, this.ends[2], this.ends[3])];
    this.frame.setScale([this.ends[0], this.ends[1]], [this.ends[2], this.ends[3]]);
  }
}

export class Loops {
  readonly element = h("div", { class: "loops" });
  private readonly loops: Loop[];
  private drawn = 0;
  private breath = -1;

  constructor() {
    this.loops = [
      new Loop("Pressure-volume", "pressure", "volume", ["cmH2O", "mL"], colour("--pressure")),
      new Loop("Flow-volume", "volume", "flow", ["mL", "L/min"], colour("--flow")),
    ];
    this.element.append(...this.loops.map((loop) => loop.host));
    new ResizeObserver(() => this.fit()).observe(this.element);
  }

  private fit(): void {
    for (const loop of this.loops) {
      const [width, height] = [loop.host.clientWidth, loop.host.clientHeight];
      loop.fit(width, height - 20);
    }
    this.drawn = 0;
  }

  /** Draws the newest breaths of a ring, at most ten times a second. */
  draw(now: number, ring: Ring | null, device: Device): void {
    if (ring === null || now - this.drawn < EVERY || this.element.offsetParent === null) return;
    this.drawn = now;
    this.element.classList.toggle("measured", device.breath?.estimated === false);
    const current = ring.breathBefore(ring.end);
    if (current === null) return;
    const before = ring.breathBefore(current);
    const part = (begin: number, to: number, hue: string, width: number) => ({ value: along(ring, begin), length: to - begin, colour: hue, width });
    const breaths = [part(current, ring.end, "", 2)];
    if (before !== null) breaths.unshift(part(before, current, colour("--faded"), 1.25));
    if (device.reference) breaths.unshift({ value: of(device.reference), length: device.reference.length, colour: colour("--reference"), width: 1.25 });
    for (const loop of this.loops) loop.draw(breaths, current !== this.breath);
    this.breath = current;
  }
}

function along(ring: Ring, begin: number): Value {
  return (axis, age) => (axis === "flow" ? 60 : 1) * ring.at(axis, begin + age);
}

function of(reference: Reference): Value {
  return (axis, age) => (axis === "flow" ? 60 : 1) * reference.at(axis, age);
}
