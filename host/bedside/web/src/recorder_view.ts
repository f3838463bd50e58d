// The part of a panel with the flight recorder of a device: the curves up to its newest tick, and its events.

import uPlot from "uplot";
import { axisBelow, axisOf, fitTo, PADDING, UPWARDS } from "./chart";
import type { Device } from "./device";
import { button, colour, h, setText, show } from "./dom";
import { fixed } from "./format";
import type { FlightRecorder, LogLine, Recorded } from "./stream";

/** A curve: its name, colour and values, and whether it changes in steps. */
interface Curve { name: string; hue: string; values: (recorded: Recorded) => (number | null)[]; steps?: boolean }

/** Charts of a part: unit, height in pixels, and curves. */
const CHARTS: { unit: string; height: number; curves: Curve[] }[] = [
  {
    unit: "cmH2O", height: 150, curves: [
      { name: "Target", hue: "--target", values: ({ target }) => target },
      { name: "Pressure", hue: "--pressure", values: ({ pressure }) => pressure },
    ],
  },
  {
    unit: "%", height: 100, curves: [
      { name: "Inspiratory valve", hue: "--valve", values: ({ u_in }) => u_in },
      { name: "Expiratory valve", hue: "--dim", values: ({ u_out }) => u_out, steps: true },
    ],
  },
];

export class RecorderView {
  readonly element: HTMLElement;
  private readonly read = button("Read the flight recorder", () => void this.ask());
  private readonly none = h("p", { class: "quiet" });
  private readonly curves = h("div", { class: "charts" });
  private readonly events = h("ol", { class: "log", "aria-label": "Events of the flight recorder, the newest first" });
  private plots: uPlot[] = [];
  private shown: FlightRecorder | null = null;
  private reading = false;

  /** `request` asks the shown device for its recorder. */
  constructor(private readonly request: () => Promise<unknown>) {
    this.element = h("div", {}, h("div", { class: "row" }, this.read), this.none, this.curves, this.events);
    fitTo(this.curves, () => this.plots);
  }

  /** `mayEver` tells whether the server lets any page read it. */
  update(device: Device, mayEver: boolean): void {
    const { recorder } = device;
    // A replay has its events from the start, or none.
    show(this.read, mayEver && !device.replay);
    show(this.none, recorder === null);
    setText(this.none, device.replay ? "This recording has no event log." : "Not read yet.");
    if (recorder === this.shown) return;
    this.shown = recorder;
    this.events.replaceChildren(...[...(recorder?.events ?? [])].reverse().map(line));
    this.draw(recorder);
  }

  private async ask(): Promise<void> {
    if (this.reading) return;
    this.reading = true;
    setText(this.read, "Reading the flight recorder");
    await this.request();
    setText(this.read, "Read the flight recorder");
    this.reading = false;
  }

  private draw(recorder: FlightRecorder | null): void {
    for (const plot of this.plots) plot.destroy();
    this.plots = [];
    this.curves.replaceChildren();
    if (recorder?.fast) this.part("The last seconds, every tick", recorder.fast);
    if (recorder?.slow) this.part("The last minute, every 20th tick with the highest pressure of the 20", recorder.slow);
  }

  private part(name: string, recorded: Recorded): void {
    this.curves.append(h("h3", {}, name));
    for (const { unit, height, curves } of CHARTS) {
      const host = h("div", { class: "chart", role: "img", "aria-label": `${name}: ${curves.map((curve) => curve.name).join(", ")}` });
      this.curves.append(host);
      const data: uPlot.AlignedData = [recorded.time, ...curves.map(({ values }) => values(recorded))];
      this.plots.push(new uPlot(options(name, unit, height, this.curves.clientWidth || 320, curves), data, host));
    }
  }
}

function line({ start, seconds, text }: LogLine): HTMLElement {
  return h("li", {}, h("time", {}, `start ${start}, ${seconds.toFixed(3)} s`), ` ${text}`);
}

/** A chart over seconds. Dragging shows a part of it, in all charts with the same `part`; a double click shows it whole again. */
function options(part: string, unit: string, height: number, width: number, curves: readonly Curve[]): uPlot.Options {
  const value = (digits: number) => (_: uPlot, one: number | null) => fixed(one, digits);
  const steps = uPlot.paths.stepped?.({ align: 1 });
  return {
    width,
    height,
    padding: PADDING,
    cursor: { y: false, drag: { x: true, y: false }, points: { size: 6 }, sync: { key: part } },
    scales: { x: { time: false }, y: UPWARDS },
    series: [
      { label: "s", value: value(3) },
      ...curves.map(({ name, hue, steps: inSteps }) => ({
        label: name, stroke: colour(hue), width: 1.5, value: value(1), points: { show: false }, ...(inSteps && steps ? { paths: steps } : {}),
      })),
    ],
    axes: [axisBelow(60), axisOf(unit)],
  };
}
