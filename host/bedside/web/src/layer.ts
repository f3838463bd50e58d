// Draws waveforms as a sweep on a canvas of its own. Each picture erases the bar and adds the samples that came since the last
// one; everything is drawn again only if size, scale or sweep changes.

import { decimate, type Points } from "./decimate";
import type { Reference } from "./reference";
import type { Ring } from "./ring";
import type { Column } from "./stream";
import { erased, firstShown, place, type Run, runs, type Sweep } from "./sweep";

export interface Trace {
  column: Column;
  colour: string;
  width: number;
  /** Factor from the stream's unit to the shown one. */
  factor?: number;
  /** Fills down to the lower edge instead of drawing a line. */
  fill?: boolean;
  /** Whether the reference breath is drawn behind it, in this colour. */
  reference?: string;
}

export class Layer {
  readonly canvas = document.createElement("canvas");
  private readonly context = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  private size: [number, number] = [0, 0];
  private range: [number, number] = [0, 1];
  private sweep: Sweep = { seconds: 12, tick: 0.001 };
  /** The ring drawn so far and the index of the next sample; null asks for a new picture. */
  private drawn: { ring: Ring; next: number; head: number } | null = null;

  constructor(private readonly traces: readonly Trace[]) {
    this.canvas.className = "layer";
    this.canvas.setAttribute("aria-hidden", "true");
  }

  /** Sets the size in CSS pixels. */
  resize(width: number, height: number): void {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    if (this.size[0] === width && this.size[1] === height && this.canvas.width === Math.round(width * ratio)) return;
    this.size = [width, height];
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    this.context.setTransform(this.canvas.width / Math.max(width, 1), 0, 0, this.canvas.height / Math.max(height, 1), 0, 0);
    this.drawn = null;
  }

  setRange(low: number, high: number): void {
    if (this.range[0] === low && this.range[1] === high) return;
    this.range = [low, high];
    this.drawn = null;
  }

  setSweep(sweep: Sweep): void {
    if (this.sweep.seconds === sweep.seconds && this.sweep.tick === sweep.tick) return;
    this.sweep = sweep;
    this.drawn = null;
  }

  /** Asks for a new picture. */
  invalidate(): void {
    this.drawn = null;
  }

  /** Draws the samples that came since the last picture. */
  update(ring: Ring, reference: Reference | null): void {
    const first = firstShown(ring, this.sweep);
    const known = this.drawn;
    if (known === null || known.ring !== ring || known.next <= first) {
      this.context.clearRect(0, 0, ...this.size);
      this.paint(ring, first, reference);
    } else if (known.next < ring.end) {
      this.erase(known.head, place(ring.newest, this.sweep));
      this.paint(ring, Math.max(known.next - 1, first), reference);
    }
    if (ring.end > ring.oldest) this.drawn = { ring, next: ring.end, head: place(ring.newest, this.sweep) };
  }

  private erase(before: number, now: number): void {
    const [width, height] = this.size;
    for (const [left, right] of erased(before, now)) {
      this.context.clearRect(left * width - 1, 0, (right - left) * width + 2, height);
    }
  }

  private paint(ring: Ring, begin: number, reference: Reference | null): void {
    for (const run of runs(ring, begin, ring.end, this.sweep)) {
      for (const trace of this.traces) {
        if (trace.reference !== undefined && reference !== null) this.referenceOf(ring, run, trace, reference);
        this.trace(ring, run, trace);
      }
    }
  }

  private trace(ring: Ring, run: Run, trace: Trace): void {
    const factor = trace.factor ?? 1;
    const points = this.points(ring, run, (index) => factor * ring.at(trace.column, index));
    if (trace.fill) this.fill(points, trace.colour);
    else this.stroke(points, trace.colour, trace.width);
  }

  private referenceOf(ring: Ring, run: Run, trace: Trace, reference: Reference): void {
    const values = reference.along(ring, run, trace.column);
    const factor = trace.factor ?? 1;
    const points = this.points(ring, run, (index) => factor * (values[index - run.begin] ?? Number.NaN));
    this.stroke(points, trace.reference ?? trace.colour, 1);
  }

  private points(ring: Ring, run: Run, value: (index: number) => number): Points {
    const [width] = this.size;
    const x = (index: number) => place(ring.tickAt(run.begin + index), this.sweep) * width;
    return decimate(run.end - run.begin, x, (index) => value(run.begin + index));
  }

  private y(value: number): number {
    const [low, high] = this.range;
    const height = this.size[1];
    // A value outside the scale stays visible at its edge.
    return Math.min(Math.max((1 - (value - low) / (high - low)) * height, 0.5), height - 0.5);
  }

  private stroke({ x, y }: Points, colour: string, width: number): void {
    const { context } = this;
    context.beginPath();
    let pen = false;
    for (const [index, value] of y.entries()) {
      if (Number.isNaN(value)) pen = false;
      else if (pen) context.lineTo(x[index] ?? 0, this.y(value));
      else {
        context.moveTo(x[index] ?? 0, this.y(value));
        pen = true;
      }
    }
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.lineJoin = "round";
    context.stroke();
  }

  private fill({ x, y }: Points, colour: string): void {
    const height = this.size[1];
    this.context.fillStyle = colour;
    for (let index = 1; index < y.length; index++) {
      // Whole pixels, so that neighbours neither overlap nor leave a seam.
      const [left, right] = [Math.ceil(x[index - 1] ?? 0), Math.ceil(x[index] ?? 0)];
      const top = this.y(y[index - 1] ?? 0);
      if (right > left && top < height - 1) this.context.fillRect(left, top, right - left, height - top);
    }
  }
}
