// Two cursors on a frozen picture, moved by pointer or arrow keys, and a table of the values under them.

import { h, setAttribute, setText, show } from "./dom";
import { fixed } from "./format";
import type { Ring } from "./ring";
import type { Column } from "./stream";
import { place, type Sweep, sampleAt } from "./sweep";

/** The picture under the cursors. */
interface Picture {
  ring: Ring | null;
  sweep: Sweep;
  /** Left edge and width of the curves, pixels. */
  left: number;
  width: number;
}

/** Name, column, factor, decimals and unit of a value, and whether it is estimated without a flow sensor. */
const FIGURES: [string, Column, number, number, string, boolean?][] = [
  ["Pressure", "pressure", 1, 1, "cmH2O"], ["Target", "target", 1, 1, "cmH2O"], ["Flow", "flow", 60, 1, "L/min", true],
  ["Volume", "volume", 1, 0, "mL", true], ["Insp. valve", "u_in", 1, 1, "%"], ["Learned", "learned", 1, 1, "%"],
];
const NAMES = ["A", "B"] as const;

export class Cursors {
  readonly table = h("div", { class: "cursor-values", role: "group", tabindex: "0", "aria-label": "Values under the cursors" });
  private readonly lines: HTMLElement[];
  /** Cells of A, of B and of their difference; the time is first. */
  private readonly cells: HTMLElement[][] = [];
  /** Places of the cursors, 0 to 1. */
  private readonly at = [0.35, 0.65];
  private held: number | null = null;

  constructor(private readonly stack: HTMLElement, private readonly picture: () => Picture) {
    this.lines = NAMES.map((name, index) => this.line(name, index));
    stack.append(...this.lines);
    this.table.append(this.build());
    stack.addEventListener("pointerdown", (event) => this.grab(event));
    stack.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) stack.addEventListener(end, () => { this.held = null; });
    this.show(false);
  }

  show(on: boolean): void {
    for (const line of this.lines) show(line, on);
    show(this.table, on);
    if (on) this.update();
  }

  /** Updates the places of the lines and the values under them. */
  update(): void {
    if (this.table.hidden) return;
    const { left, width, ring, sweep } = this.picture();
    const samples = this.at.map((at) => (ring ? sampleAt(ring, at, sweep) : null));
    for (const [index, line] of this.lines.entries()) {
      line.style.left = `${left + (this.at[index] ?? 0) * width}px`;
      this.describe(line, index, samples[index] ?? null);
    }
    if (ring) this.fill(ring, samples, sweep);
  }

  private line(name: string, index: number): HTMLElement {
    return h("div", {
      class: `cursor cursor-${name.toLowerCase()}`, role: "slider", tabindex: "0", "aria-label": `Cursor ${name}`,
      "aria-valuemin": "0", "aria-valuemax": "100", onkeydown: (event) => this.key(event as KeyboardEvent, index),
    }, h("span", {}, name));
  }

  private describe(line: HTMLElement, index: number, sample: number | null): void {
    const at = this.at[index] ?? 0;
    const { ring, sweep } = this.picture();
    setAttribute(line, "aria-valuenow", (100 * at).toFixed(1));
    const pressure = ring && sample !== null ? `${fixed(ring.at("pressure", sample), 1)} cmH2O` : "no sample";
    setAttribute(line, "aria-valuetext", `${(at * sweep.seconds).toFixed(3)} s, ${pressure}`);
  }

  private build(): HTMLElement {
    const quantities: [string, string, boolean?][] = [["Time", "s"], ...FIGURES.map(([name, , , , unit, estimated]): [string, string, boolean?] => (estimated ? [name, unit, true] : [name, unit]))];
    const heads = quantities.map(([name, unit, estimated]) => {
      const mark = estimated ? [h("small", { class: "estimated" }, "est."), " "] : [];
      return h("th", { scope: "col" }, name, " ", ...mark, h("small", {}, unit));
    });
    const body = [...NAMES, "B − A"].map((name) => {
      const cells = quantities.map(() => h("td"));
      this.cells.push(cells);
      return h("tr", {}, h("th", { scope: "row" }, name), ...cells);
    });
    return h("table", {}, h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Cursor"), ...heads)), h("tbody", {}, ...body));
  }

  private fill(ring: Ring, samples: (number | null)[], sweep: Sweep): void {
    const write = (figure: number, values: (number | null)[], digits: number) => {
      const [a, b] = values;
      const difference = a == null || b == null ? null : b - a;
      for (const [index, value] of [a ?? null, b ?? null, difference].entries()) {
        const cell = this.cells[index]?.[figure];
        if (cell) setText(cell, fixed(value, digits));
      }
    };
    write(0, samples.map((sample) => sample === null ? null : (ring.tickAt(sample) - ring.newest) * sweep.tick), 3);
    for (const [index, [, column, factor, digits]] of FIGURES.entries()) {
      write(index + 1, samples.map((sample) => sample === null ? null : factor * ring.at(column, sample)), digits);
    }
  }

  private key(event: KeyboardEvent, index: number): void {
    const { sweep, ring } = this.picture();
    // One arrow is 10 ms, with Shift 100 ms.
    const step = (event.shiftKey ? 0.1 : 0.01) / sweep.seconds;
    const moves: Record<string, number> = { ArrowLeft: -step, ArrowDown: -step, ArrowRight: step, ArrowUp: step, PageDown: -10 * step, PageUp: 10 * step };
    const at = this.at[index] ?? 0;
    const move = moves[event.key];
    if (move !== undefined) this.move(index, at + move);
    else if (event.key === "Home") this.move(index, 0);
    else if (event.key === "End") this.move(index, ring ? place(ring.newest, sweep) : 1);
    else return;
    event.preventDefault();
  }

  private move(index: number, at: number): void {
    this.at[index] = Math.min(Math.max(at, 0), 0.9999);
    this.update();
  }

  private under(event: PointerEvent): number {
    const { left, width } = this.picture();
    return (event.clientX - this.stack.getBoundingClientRect().left - left) / Math.max(width, 1);
  }

  private grab(event: PointerEvent): void {
    if (this.table.hidden) return;
    const at = this.under(event);
    const [a = 0, b = 1] = this.at;
    this.held = Math.abs(at - a) <= Math.abs(at - b) ? 0 : 1;
    this.lines[this.held]?.focus();
    this.move(this.held, at);
    event.preventDefault();
  }

  private drag(event: PointerEvent): void {
    if (this.held !== null) this.move(this.held, this.under(event));
  }
}
