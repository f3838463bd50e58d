// Axes, grid and limit lines of a picture by uPlot; the curves are drawn on a layer above it. So a moving curve costs only its
// own pixels.

import uPlot from "uplot";
import { colour } from "./dom";

/** A horizontal line with a text, such as a limit. */
export interface Mark {
  value: number;
  text: string;
  colour: string;
}

export interface FrameOptions {
  /** Text of the vertical axis. */
  label: string;
  /** Text after each number of the horizontal axis; none hides the axis. */
  bottom?: string;
  /** Least distance of two lines of the grid, pixels. */
  space?: number;
}

/** Height of the horizontal axis, pixels. */
export const BOTTOM = 20;
const FONT = "11px system-ui, 'DejaVu Sans', sans-serif";

export class Frame {
  readonly plot: uPlot;
  private x: [number, number] = [0, 1];
  private y: [number, number] = [0, 1];
  private marks: Mark[] = [];

  constructor(host: HTMLElement, private readonly options: FrameOptions, over: HTMLElement) {
    this.plot = new uPlot(this.describe(), [[0, 1], [null, null]], host);
    this.plot.over.append(over);
  }

  /** Width and height of the area of the curves, CSS pixels. */
  get inner(): [number, number] {
    return [this.plot.over.clientWidth, this.plot.over.clientHeight];
  }

  /** Distance of that area from the left edge, CSS pixels. */
  get left(): number {
    return this.plot.over.offsetLeft;
  }

  resize(width: number, height: number): void {
    if (this.plot.width !== width || this.plot.height !== height) this.plot.setSize({ width, height });
  }

  setScale(x: [number, number], y: [number, number]): void {
    if (`${x}` === `${this.x}` && `${y}` === `${this.y}`) return;
    [this.x, this.y] = [x, y];
    this.plot.batch(() => {
      this.plot.setScale("x", { min: x[0], max: x[1] });
      this.plot.setScale("y", { min: y[0], max: y[1] });
    });
  }

  setMarks(marks: Mark[]): void {
    if (JSON.stringify(marks) === JSON.stringify(this.marks)) return;
    this.marks = marks;
    this.plot.redraw(false);
  }

  private describe(): uPlot.Options {
    const { label, bottom, space } = this.options;
    const axis = { stroke: colour("--dim"), font: FONT, labelFont: FONT, grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false } };
    return {
      width: 300,
      height: 100,
      padding: [6, 12, bottom === undefined ? 6 : 0, 0],
      cursor: { show: false },
      legend: { show: false },
      scales: { x: { time: false, range: () => this.x }, y: { range: () => this.y } },
      series: [{}, {}],
      axes: [
        { ...axis, size: bottom === undefined ? 0 : BOTTOM, gap: 3, values: (_, ticks) => ticks.map((tick) => (bottom === undefined ? "" : `${tick}${bottom}`)) },
        { ...axis, size: 40, gap: 4, label, labelSize: 15, labelGap: 0, space: space ?? 24 },
      ],
      hooks: { draw: [(plot) => this.drawMarks(plot)] },
    };
  }

  private drawMarks(plot: uPlot): void {
    const { ctx, bbox } = plot;
    const ratio = uPlot.pxRatio;
    ctx.save();
    ctx.font = `${11 * ratio}px system-ui, 'DejaVu Sans', sans-serif`;
    ctx.textAlign = "right";
    for (const mark of this.marks) {
      const above = mark.value > this.y[1];
      const y = Math.round(above ? bbox.top + ratio : plot.valToPos(mark.value, "y", true));
      ctx.strokeStyle = mark.colour;
      ctx.fillStyle = mark.colour;
      ctx.lineWidth = ratio;
      ctx.setLineDash(above ? [2 * ratio, 6 * ratio] : [6 * ratio, 4 * ratio]);
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
      ctx.textBaseline = y < bbox.top + 16 * ratio ? "top" : "bottom";
      const offset = ctx.textBaseline === "top" ? 3 * ratio : -2 * ratio;
      ctx.fillText(above ? `${mark.text} ↑` : mark.text, bbox.left + bbox.width - 4 * ratio, y + offset);
    }
    ctx.restore();
  }
}
