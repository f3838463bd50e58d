// Charts of the trends by uPlot: mean lines with the range from lowest to highest behind them.

import uPlot from "uplot";
import { clock } from "./alarms";
import { axisBelow, axisOf, fitTo, PADDING, UPWARDS } from "./chart";
import type { Device } from "./device";
import { colour, h } from "./dom";
import { fixed } from "./format";
import type { Trended } from "./trends";

/** Spans, hours. */
const SPANS = [0.25, 1, 8, 24, 72] as const;
/** Interval between two pictures, ms. */
const EVERY = 2_000;
const HEIGHT = 122;
const DAYS = ["Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat"];

const CHARTS: [string, [Trended, string, string][]][] = [
  ["cmH2O", [["pip", "PIP", "--pressure"], ["plateau", "Plateau", "--target"], ["peep", "PEEP", "--flow"]]],
  ["mL", [["tidal_volume", "Tidal volume", "--volume"]]],
  ["1/min, L/min", [["rate", "Rate", "--flow"], ["minute_volume", "Minute volume", "--volume"]]],
  ["lung", [["resistance", "Resistance", "--valve"], ["compliance", "Compliance", "--flow"]]],
  ["cmH2O", [["error", "Error", "--volume"], ["overshoot", "Overshoot", "--pressure"]]],
];

export class TrendCharts {
  readonly element = h("div", { class: "trends" });
  private readonly charts: { plot: uPlot; names: Trended[] }[] = [];
  private readonly hosts = h("div", { class: "charts" });
  private readonly span: HTMLSelectElement;
  private drawn = 0;
  private device: Device | null = null;

  constructor() {
    const options = SPANS.map((hours) => h("option", { value: String(hours) }, spanName(hours)));
    this.span = h("select", { id: "trend-span", onchange: () => { this.drawn = 0; } }, ...options);
    this.element.append(h("label", { class: "field" }, h("span", {}, "Span"), this.span), this.hosts);
    for (const [unit, lines] of CHARTS) this.chart(unit, lines);
    fitTo(this.hosts, () => this.charts.map(({ plot }) => plot));
  }

  draw(now: number, device: Device): void {
    if (device !== this.device) this.drawn = 0;
    this.device = device;
    if (now - this.drawn < EVERY || this.element.offsetParent === null) return;
    this.drawn = now;
    for (const { plot, names } of this.charts) {
      const series = names.map((name) => device.trends.series(name, Number(this.span.value)));
      const time = series[0]?.time ?? [];
      plot.setData([time, ...series.flatMap(({ mean, low, high }) => [mean, low, high])]);
    }
  }

  private chart(unit: string, lines: [Trended, string, string][]): void {
    const host = h("div", { class: "chart", role: "img", "aria-label": `Trend of ${lines.map(([, name]) => name).join(", ")}` });
    this.hosts.append(host);
    const plot = new uPlot({
      width: 320,
      height: HEIGHT,
      padding: PADDING,
      cursor: { y: false, drag: { x: false, y: false }, points: { size: 6 } },
      legend: { live: true },
      scales: { x: { time: true, range: () => this.range() }, y: UPWARDS },
      series: [{ label: "Time", value: (_, time) => (time === null ? "--" : this.timeOf(time)) }, ...lines.flatMap(([, name, hue]) => series(name, colour(hue)))],
      bands: lines.map(([, , hue], index) => ({ series: [3 * index + 3, 3 * index + 2] as [number, number], fill: `${colour(hue)}40` })),
      axes: [{ ...axisBelow(75), values: (_, times) => times.map((time) => this.timeOf(time)) }, axisOf(unit)],
    }, [[], ...lines.flatMap(() => [[], [], []])] as uPlot.AlignedData, host);
    this.charts.push({ plot, names: lines.map(([name]) => name) });
  }

  /** Time of day; with the weekday in a long span. */
  private timeOf(time: number): string {
    const date = new Date(time * 1000);
    const day = Number(this.span.value) >= 24 ? `${DAYS[date.getDay()]} ` : "";
    return day + clock(time * 1000).slice(0, 5);
  }

  /** The span up to now, s. */
  private range(): [number, number] {
    const end = (this.device?.time_ms || Date.now()) / 1000;
    return [end - Number(this.span.value) * 3600, end];
  }
}

function spanName(hours: number): string {
  if (hours < 1) return `${60 * hours} minutes`;
  return hours === 1 ? "1 hour" : `${hours} hours`;
}

/** Mean, lowest and highest of a figure. */
function series(name: string, hue: string): uPlot.Series[] {
  const value = (_: uPlot, one: number | null) => fixed(one, 1);
  const hidden = { width: 0, points: { show: false }, value };
  return [
    { label: name, stroke: hue, width: 1.5, value, points: { size: 3 } },
    { label: `${name}, lowest`, class: "hidden-series", ...hidden },
    { label: `${name}, highest`, class: "hidden-series", ...hidden },
  ];
}
