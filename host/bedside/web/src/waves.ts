// The waveforms of one device: strips with axes, curves by an erase-bar sweep, freeze and cursors.

import { clock } from "./alarms";
import { Cursors } from "./cursors";
import type { Device } from "./device";
import { h, setAttribute, setText, show } from "./dom";
import { origin } from "./format";
import { BOTTOM, Frame } from "./frame";
import { Layer } from "./layer";
import { MarkerLines } from "./markers";
import type { Ring } from "./ring";
import { end, extremes } from "./scale";
import { pressureMarks, type Strip, strips } from "./strips";
import { firstShown, place, type Sweep } from "./sweep";

/** Interval between two looks at the scales, ms. */
const SCALE_EVERY = 500;

interface Row {
  strip: Strip;
  host: HTMLElement;
  frame: Frame;
  layer: Layer;
  ends: [number, number];
}

export class Waves {
  readonly element = h("section", { class: "waves", "aria-label": "Waveforms" });
  private readonly stack = h("div", { class: "stack" });
  private readonly shade = h("div", { class: "shade" });
  /** Says that the picture is frozen, since when, and whether anything arrives meanwhile. */
  private readonly held = h("p", { class: "held", role: "status" });
  private heldSince = "";
  private readonly origin = h("span", { class: "origin" });
  private readonly rows: Row[];
  private readonly cursors: Cursors;
  private readonly markers: MarkerLines;
  private device: Device | null = null;
  private frozen: Ring | null = null;
  private sweep: Sweep = { seconds: 12, tick: 0.001 };
  private scaled = 0;
  private pass = 0;
  /** The ring of the last picture, and the index of the first sample after it. */
  private drawn: { ring: Ring; next: number } | null = null;

  constructor() {
    this.element.append(this.held, this.stack, this.origin, this.shade);
    const all = strips();
    this.rows = all.map((strip, index) => this.row(strip, index === all.length - 1));
    this.cursors = new Cursors(this.stack, () => ({ ring: this.ring, sweep: this.sweep, left: this.left, width: this.width }));
    this.markers = new MarkerLines(this.stack);
    this.element.append(this.cursors.table);
    show(this.shade, false);
    new ResizeObserver(() => this.fit()).observe(this.stack);
  }

  /** The ring that is shown. */
  get ring(): Ring | null {
    return this.frozen ?? this.device?.ring ?? null;
  }

  get isFrozen(): boolean {
    return this.frozen !== null;
  }

  private get left(): number {
    return this.rows[0]?.frame.left ?? 0;
  }

  private get width(): number {
    return this.rows[0]?.frame.inner[0] ?? 0;
  }

  setDevice(device: Device): void {
    if (this.device === device) return;
    this.device = device;
    setText(this.origin, origin(device.info.kind));
    this.freeze(false);
    this.sweep = { ...this.sweep, tick: device.tick };
    for (const row of this.rows) row.ends = [0, 0];
    this.redraw();
  }

  setSeconds(seconds: number): void {
    this.sweep = { ...this.sweep, seconds };
    this.redraw();
    this.cursors.update();
  }

  /** Holds the picture, or lets it run again. */
  freeze(on: boolean): void {
    this.frozen = on && this.device ? this.device.ring.copy() : null;
    this.heldSince = `FROZEN ${clock(Date.now())}`;
    setText(this.held, this.isFrozen ? this.heldSince : "");
    this.element.classList.toggle("frozen", on);
    this.cursors.show(on);
    this.redraw();
  }

  /** Covers the curves with a text, or uncovers them. A frozen picture stays visible, and the text stands above it. */
  cover(text: string | null): void {
    show(this.shade, text !== null && !this.isFrozen);
    setText(this.shade, text ?? "");
    if (this.isFrozen) setText(this.held, text === null ? this.heldSince : `${this.heldSince}. Now: ${text}`);
  }

  redraw(): void {
    this.scaled = 0;
    for (const { layer } of this.rows) layer.invalidate();
  }

  /** Draws the samples since the last picture; returns the oldest tick that is new in it, or null if none is. */
  draw(now: number): number | null {
    const { ring, device } = this;
    if (ring === null || device === null || this.element.offsetParent === null) return null;
    if (now - this.scaled > SCALE_EVERY) this.rescale(ring, now);
    for (const { layer } of this.rows) layer.update(ring, device.reference);
    this.markers.draw(device.markers, ring, this.sweep, this.left, this.width);
    const known = this.drawn;
    this.drawn = { ring, next: ring.end };
    // A first picture has no new samples: the age of those that came before it is not the page's delay.
    if (this.isFrozen || known?.ring !== ring || known.next < ring.oldest || known.next >= ring.end) return null;
    return ring.tickAt(known.next);
  }

  private row(strip: Strip, last: boolean): Row {
    const host = h("div", { class: `strip strip-${strip.id}`, role: "img", "aria-label": strip.name });
    const legend = h("div", { class: "legend", "aria-hidden": "true" });
    for (const [text, colour] of strip.legend) {
      const name = h("span", {}, text);
      name.style.color = colour;
      legend.append(name);
    }
    if (strip.estimated) legend.append(h("span", { class: "estimated" }, "estimated"));
    this.stack.append(host);
    const layer = new Layer(strip.traces);
    const frame = new Frame(host, last ? { label: strip.label, bottom: " s" } : { label: strip.label }, layer.canvas);
    host.append(legend);
    return { strip, host, frame, layer, ends: [0, 0] };
  }

  private fit(): void {
    const [width, height] = [this.stack.clientWidth, this.stack.clientHeight];
    if (width < 50 || height < 100) return;
    const shares = this.rows.reduce((sum, row) => sum + row.strip.share, 0);
    for (const [index, row] of this.rows.entries()) {
      const extra = index === this.rows.length - 1 ? BOTTOM : 0;
      const own = Math.floor(((height - BOTTOM) * row.strip.share) / shares) + extra;
      row.host.style.height = `${own}px`;
      row.frame.resize(width, own);
    }
    // uPlot has its new size only after this call; the next picture gives it to the curves and cursors.
    this.redraw();
  }

  private rescale(ring: Ring, now: number): void {
    this.scaled = now;
    const pass = place(ring.newest, this.sweep);
    // A scale shrinks only at the start of a sweep, so that one picture has one scale.
    const mayShrink = pass < this.pass || this.rows[0]?.ends[1] === 0;
    this.pass = pass;
    const first = firstShown(ring, this.sweep);
    for (const row of this.rows) {
      row.ends = this.ends(row, ring, first, mayShrink);
      row.frame.setScale([0, this.sweep.seconds], row.ends);
      row.layer.setRange(...row.ends);
      row.layer.setSweep(this.sweep);
      row.layer.resize(...row.frame.inner);
    }
    this.cursors.update();
    this.mark(this.device?.breath?.estimated ?? true);
    this.rows[0]?.frame.setMarks(pressureMarks(this.device?.state ?? null));
  }

  private ends({ strip, ends }: Row, ring: Ring, first: number, mayShrink: boolean): [number, number] {
    if (strip.scale === "percent") return [0, 105];
    const main = strip.traces.at(-1);
    if (main === undefined) return ends;
    const factor = main.factor ?? 1;
    const [low, high] = extremes(ring.end - first, (index) => factor * ring.at(main.column, first + index));
    switch (strip.scale) {
      case "around": {
        const both = end(ends[1], Math.max(1.1 * high, -1.1 * low, 10), mayShrink);
        return [-both, both];
      }
      case "share": return [low < -1 ? -100 : 0, 105];
      case "pressure": return [low < -1 ? -end(-ends[0], -low, mayShrink) : 0, end(ends[1], Math.max(high * 1.02, this.highest()), mayShrink)];
      default: return [low < -0.1 * high ? -end(-ends[0], -low, mayShrink) : 0, end(ends[1], Math.max(1.1 * high, 10), mayShrink)];
    }
  }

  /** Marks flow and volume as estimated, unless a flow sensor measures them. */
  private mark(estimated: boolean): void {
    this.element.classList.toggle("measured", !estimated);
    for (const { strip, host } of this.rows) setAttribute(host, "aria-label", strip.estimated && estimated ? `${strip.name}, estimated` : strip.name);
  }

  /** The pressure that the scale must hold: PIP with room above it. */
  private highest(): number {
    return 1.25 * (this.device?.state?.settings.pip ?? 20);
  }
}
