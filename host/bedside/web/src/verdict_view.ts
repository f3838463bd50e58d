// The panel with the verdict on a recording: how many breaths violate which limit, the accuracy, and what is wrong most.

import type { Device } from "./device";
import { h } from "./dom";
import { count, fixed, plain } from "./format";
import type { LimitCheck, Tolerance, Verdict } from "./stream";

export class VerdictPanel {
  readonly element = h("div", { class: "verdict" });
  private known: Verdict | null = null;

  update(device: Device): void {
    if (device.verdict === this.known) return;
    this.known = device.verdict;
    this.element.replaceChildren(...(this.known ? content(this.known) : []));
  }
}

function content(verdict: Verdict): HTMLElement[] {
  if (verdict.refused !== null) return [h("p", { class: "quiet" }, `No verdict: ${verdict.refused}.`)];
  const parts: HTMLElement[] = [h("h2", {}, "Breaths"), h("p", { class: "verdict-share" }, share(verdict))];
  for (const remark of remarks(verdict)) parts.push(h("p", { class: "quiet" }, remark));
  parts.push(h("h2", {}, "Limits"), table(verdict.limits));
  if (verdict.sore_spots.length > 0) {
    parts.push(h("h2", {}, "Sore spots, the most severe first"), h("ol", { class: "log" }, ...verdict.sore_spots.map((text) => h("li", {}, text))));
  }
  return parts;
}

/** The share of the breaths that violate a limit, in words. */
export function share({ violating, breaths }: Pick<Verdict, "violating" | "breaths">): string {
  return `${count(violating)} of ${count(breaths)} judged breaths (${percent(violating, breaths)}) violate a limit.`;
}

function percent(part: number, of: number): string {
  return of > 0 ? `${((100 * part) / of).toFixed(part > 0 && 1000 * part < 95 * of ? 1 : 0)} %` : "0 %";
}

function remarks(verdict: Verdict): string[] {
  const found: string[] = [];
  if (verdict.unjudged > 0) found.push(`Breaths that cannot be judged: ${count(verdict.unjudged)}.`);
  if (verdict.error !== null) found.push(`Mean error over the inspirations: ${fixed(verdict.error, 2)} cmH2O.`);
  if (verdict.inspiration) found.push(`Accuracy at the end of inspiration: ±(${tolerance(verdict.inspiration, "cmH2O")}).`);
  if (verdict.expiration) found.push(`Accuracy at the end of expiration: ±(${tolerance(verdict.expiration, "cmH2O")}).`);
  if (verdict.explored > 0) found.push(`Exploration perturbs ${percent(verdict.explored, 1)} of the inspiratory ticks.`);
  return found;
}

function tolerance({ fixed: part, percent: share }: Tolerance, unit: string): string {
  return `${plain(part)} ${unit}${share > 0 ? ` + ${plain(share)} %` : ""}`;
}

function table(limits: readonly LimitCheck[]): HTMLElement {
  const head = ["Limit", "Breaths", "Share", "Worst"].map((text) => h("th", { scope: "col" }, text));
  const rows = limits.map((one) => h(
    "tr", { "data-violated": String(one.violations > 0) },
    h("th", { scope: "row" }, one.name, h("small", {}, tolerance(one.limit, one.unit))),
    h("td", {}, `${count(one.violations)} of ${count(one.checked)}`),
    h("td", {}, percent(one.violations, one.checked)),
    h("td", {}, ...(one.worst === null ? [] : [fixed(one.worst, 1), h("small", {}, `breath ${one.worst_breath}`)])),
  ));
  return h("table", { class: "limits" }, h("thead", {}, h("tr", {}, ...head)), h("tbody", {}, ...rows));
}
