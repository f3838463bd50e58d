// Markers on the curves: a thin vertical line with its text at the tick at which it was set.

import { h, setText } from "./dom";
import type { Ring } from "./ring";
import { place, type Sweep, shown } from "./sweep";

/** A moment that a user has marked. */
export interface Marker {
  tick: number;
  text: string;
  /** Time of the server, Unix ms. */
  time_ms: number;
}

/** Most markers kept. */
export const MARKERS = 100;

/** The markers that the sweep shows, each with its place, 0 to 1. */
export function visible(markers: readonly Marker[], newest: number, oldest: number, sweep: Sweep): { at: number; text: string }[] {
  const first = Math.max(newest - shown(sweep), oldest);
  return markers.filter(({ tick }) => tick > first && tick <= newest).map(({ tick, text }) => ({ at: place(tick, sweep), text }));
}

/** The lines of the markers, over all curves. */
export class MarkerLines {
  private readonly lines: { element: HTMLElement; name: HTMLElement }[] = [];

  constructor(private readonly host: HTMLElement) {}

  /** Places the lines in an area of this left edge and width, pixels. */
  draw(markers: readonly Marker[], ring: Ring, sweep: Sweep, left: number, width: number): void {
    const oldest = ring.end > ring.oldest ? ring.tickAt(ring.oldest) - 1 : Number.POSITIVE_INFINITY;
    const found = markers.length > 0 ? visible(markers, ring.newest, oldest, sweep) : [];
    while (this.lines.length < found.length) this.add();
    for (const surplus of this.lines.splice(found.length)) surplus.element.remove();
    for (const [index, { at, text }] of found.entries()) {
      const line = this.lines[index];
      if (line === undefined) continue;
      const x = `${Math.round(left + at * width)}px`;
      if (line.element.style.left !== x) line.element.style.left = x;
      // Near the right edge the text stands at the left of its line.
      line.element.classList.toggle("marker-left", at > 0.8);
      setText(line.name, text);
    }
  }

  private add(): void {
    const name = h("span");
    const element = h("div", { class: "marker" }, name);
    this.lines.push({ element, name });
    this.host.append(element);
  }
}
