// What the charts by uPlot have in common: their look, and their width.

import type uPlot from "uplot";
import { colour } from "./dom";

const FONT = "11px system-ui, 'DejaVu Sans', sans-serif";

/** Look of an axis. */
export function axis(): uPlot.Axis {
  return { stroke: colour("--dim"), font: FONT, labelFont: FONT, grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false } };
}

/** Look of the axis at the left, with its unit. */
export function axisOf(unit: string): uPlot.Axis {
  return { ...axis(), size: 40, gap: 4, label: unit, labelSize: 15, labelGap: 0, space: 24 };
}

/** Keeps charts as wide as the element around them. */
export function fitTo(element: HTMLElement, charts: () => readonly uPlot[]): void {
  new ResizeObserver(() => {
    const width = element.clientWidth;
    if (width < 100) return;
    for (const chart of charts()) if (chart.width !== width) chart.setSize({ width, height: chart.height });
  }).observe(element);
}
