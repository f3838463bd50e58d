// What the charts by uPlot have in common: their look, and their width.

import type uPlot from "uplot";
import { colour } from "./dom";

const FONT = "11px system-ui, 'DejaVu Sans', sans-serif";

/** Space around a chart, and its scale, which contains 0 and is at least 1 high. */
export const PADDING: uPlot.Padding = [4, 8, 0, 0];
export const UPWARDS: uPlot.Scale = { range: (_, low, high) => [Math.min(low ?? 0, 0), Math.max((high ?? 1) * 1.1, 1)] };

function look(): uPlot.Axis {
  return { stroke: colour("--dim"), font: FONT, labelFont: FONT, grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false } };
}

/** The axis below, with at least `space` pixels from one value to the next. */
export function axisBelow(space: number): uPlot.Axis {
  return { ...look(), size: 20, gap: 3, space };
}

/** The axis at the left, with its unit. */
export function axisOf(unit: string): uPlot.Axis {
  return { ...look(), size: 40, gap: 4, label: unit, labelSize: 15, labelGap: 0, space: 24 };
}

/** Keeps charts as wide as the element around them. */
export function fitTo(element: HTMLElement, charts: () => readonly uPlot[]): void {
  new ResizeObserver(() => {
    const width = element.clientWidth;
    if (width < 100) return;
    for (const chart of charts()) if (chart.width !== width) chart.setSize({ width, height: chart.height });
  }).observe(element);
}
