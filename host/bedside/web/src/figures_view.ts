// Figures that the server describes: curves by uPlot, also over a logarithmic axis, and round ones, whose curves are lines in a plane.

import uPlot from "uplot";
import { axisBelow, axisOf, PADDING } from "./chart";
import { colour, h } from "./dom";
import { fixed } from "./format";
import { Frame } from "./frame";
import type { Chart, Curve } from "./stream";

const HEIGHT = 150;
/** Largest width of a round figure, pixels. */
const ROUND = 340;
/** Colours of curves without a role, in their order. */
const OTHERS = ["--flow", "--volume", "--learned"];
/** Dashes of a dashed line, pixels. */
const DASHES = [5, 4];

export class Figures {
  readonly element = h("div", { class: "charts" });
  private resize: ((width: number) => void)[] = [];
  private plots: uPlot[] = [];

  constructor() {
    new ResizeObserver(() => this.fit()).observe(this.element);
  }

  show(charts: readonly Chart[]): void {
    for (const plot of this.plots) plot.destroy();
    [this.plots, this.resize] = [[], []];
    this.element.replaceChildren();
    for (const chart of charts) this.add(chart);
    this.fit();
  }

  private fit(): void {
    const width = this.element.clientWidth;
    if (width < 100) return;
    for (const resize of this.resize) resize(width);
  }

  private add(chart: Chart): void {
    const names = chart.curves.map(({ name }) => name).join(", ");
    const host = h("div", { class: "chart", role: "img", "aria-label": `${chart.title}: ${names}` });
    this.element.append(h("h3", {}, chart.title), host);
    if (chart.square !== null) {
      const round = new Round(chart, chart.square, host);
      this.plots.push(round.plot);
      this.resize.push((width) => round.resize(Math.min(width, ROUND)));
      return;
    }
    const { x: data } = chart.curves[0] ?? { x: [] };
    const plot = new uPlot(options(chart), [data, ...chart.curves.map(({ y }) => y)], host);
    this.plots.push(plot);
    this.resize.push((width) => plot.setSize({ width, height: HEIGHT }));
  }
}

/** The colours of curves: of what they stand for, or the next one. */
function hues(curves: readonly Curve[]): string[] {
  const others = curves.filter((curve) => named(curve) === null);
  return curves.map((curve) => colour(named(curve) ?? OTHERS[others.indexOf(curve) % OTHERS.length] ?? "--flow"));
}

function named({ role, dashed }: Curve): string | null {
  if (["target", "pressure", "valve", "limit"].includes(role)) return `--${role}`;
  return dashed ? "--reference" : null;
}

function options({ x_label, y_label, log_x, log_y, curves }: Chart): uPlot.Options {
  const value = (digits: number) => (_: uPlot, one: number | null) => fixed(one, digits);
  const whole = (_: uPlot, low: number | null, high: number | null): [number, number] => [low ?? 1, high ?? 10];
  const colours = hues(curves);
  const [unit = ""] = x_label.split(", ").slice(1);
  const y: uPlot.Scale = log_y ? { distr: 3, range: whole } : { range: (_, low, high) => [Math.min((low ?? 0) * 1.05, 0), Math.max((high ?? 0) * 1.05, 0)] };
  return {
    width: ROUND,
    height: HEIGHT,
    padding: PADDING,
    cursor: { y: false, drag: { x: false, y: false }, points: { size: 6 } },
    scales: { x: { time: false, ...(log_x ? { distr: 3, range: whole } : {}) }, y },
    series: [
      { label: unit, value: value(2) },
      ...curves.map((curve, place) => ({
        label: curve.name, stroke: colours[place] ?? "", width: 1.5, value: value(2), points: { show: log_x, size: 4 },
        ...(curve.dashed ? { dash: DASHES } : {}),
      })),
    ],
    axes: [
      { ...axisBelow(40), values: (_, ticks) => ticks.map((tick) => `${tick} ${unit}`), ...(log_x ? decades : {}) },
      { ...axisOf(y_label), ...(log_y ? { ...decades, values: (_: uPlot, ticks: number[]) => ticks.map(String) } : {}) },
    ],
  };
}

/** Lines of a logarithmic axis: 1, 2 and 5 of each decade between its ends. */
const decades = {
  filter: (_: uPlot, ticks: number[]) => ticks,
  splits: (_: uPlot, __: number, low: number, high: number): number[] => {
    const found: number[] = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) {
      for (const digit of [1, 2, 5]) {
        const tick = Number(`${digit}e${power}`);
        if (tick >= low && tick <= high) found.push(tick);
      }
    }
    return found;
  },
};

/** Lines in a plane with axes of the same scale. */
class Round {
  private readonly canvas = document.createElement("canvas");
  private readonly frame: Frame;
  private readonly hues: string[];

  constructor(private readonly chart: Chart, private readonly ends: [number, number], host: HTMLElement) {
    this.canvas.className = "layer";
    this.hues = hues(chart.curves);
    this.frame = new Frame(host, { label: chart.y_label, bottom: "", space: 30 }, this.canvas);
    this.frame.setScale(ends, ends);
    const entry = (curve: Curve, place: number) => {
      const line = h("i", { class: "line" });
      line.style.borderTop = `2px ${curve.dashed ? "dashed" : "solid"} ${this.hues[place]}`;
      return h("li", {}, line, ` ${curve.name}`);
    };
    host.append(h("ul", { class: "round-legend", "aria-hidden": "true" }, ...chart.curves.map(entry)));
  }

  get plot(): uPlot {
    return this.frame.plot;
  }

  resize(size: number): void {
    this.frame.resize(size, size);
    // uPlot sizes the area between the axes after this call. That area is square, not the figure.
    requestAnimationFrame(() => {
      const [width, height] = this.frame.inner;
      this.frame.resize(size, size + width - height);
      requestAnimationFrame(() => this.draw());
    });
  }

  private draw(): void {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = this.frame.inner;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    const context = this.canvas.getContext("2d");
    if (context === null) return;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [low, high] = this.ends;
    const across = (value: number) => ((value - low) / (high - low)) * width;
    const down = (value: number) => (1 - (value - low) / (high - low)) * height;
    for (const [place, curve] of this.chart.curves.entries()) {
      context.beginPath();
      for (const [point, x] of curve.x.entries()) context.lineTo(across(x), down(curve.y[point] ?? Number.NaN));
      context.setLineDash(curve.dashed ? DASHES : []);
      context.lineWidth = curve.dashed ? 1.25 : 2;
      context.strokeStyle = this.hues[place] ?? "";
      context.stroke();
    }
    // The point that a robust loop stays away from.
    context.setLineDash([]);
    context.strokeStyle = colour("--text");
    context.beginPath();
    for (const turn of [1, -1]) {
      context.moveTo(across(-1) - 4, down(0) - 4 * turn);
      context.lineTo(across(-1) + 4, down(0) + 4 * turn);
    }
    context.stroke();
  }
}
