// The result of a measurement: the margins with how sure they are, advice, and figures.

import { clock } from "./alarms";
import type { Device } from "./device";
import { h } from "./dom";
import { fixed, plain, sentence, words } from "./format";
import { Figures } from "./figures_view";
import type { Margin, Margins } from "./stream";

export class MarginsView {
  readonly element = h("div", { class: "margins" });
  private readonly words = h("div");
  private readonly figures = new Figures();
  private shown: Margins | null = null;

  constructor() {
    this.element.append(this.words, this.figures.element);
  }

  update({ margins }: Device): void {
    if (margins === this.shown) return;
    this.shown = margins;
    this.words.replaceChildren(...(margins ? content(margins) : []));
    this.figures.show(margins?.charts ?? []);
  }
}

function content(result: Margins): HTMLElement[] {
  const head = h("h2", {}, `Margins at ${clock(result.time_ms)}`);
  const remarks = result.remarks.map((text) => h("p", { class: "quiet" }, sentence(text)));
  if (result.refused !== null) return [head, h("p", { class: "no-margins" }, sentence(`no margins: ${result.refused}`)), ...remarks];
  const under = h("p", { class: "quiet" }, `Under ${result.controller}, with sines of ${plain(result.amplitude)} %.`);
  const advice = result.advice.map(({ cause, text }) => h("li", {}, h("b", {}, words(cause)), ` ${sentence(text)}`));
  const none = result.margins.every(({ unstated }) => unstated !== "not enough coherence")
    ? "No gain, delay, play or leak that stands out." : "None: not every margin could be stated.";
  return [
    head, under, table(result.margins), h("h2", {}, "Advice"),
    advice.length > 0 ? h("ul", { class: "advice" }, ...advice) : h("p", { class: "quiet" }, none),
    h("h2", {}, "Measured"), ...remarks,
  ];
}

function table(margins: readonly Margin[]): HTMLElement {
  const heads = ["Margin", "Value, 95 %", "Robust"].map((text) => h("th", { scope: "col" }, text));
  const rows = margins.map((one) => h(
    "tr", { "data-violated": String(one.keeps === false) },
    h("th", { scope: "row" }, words(one.name), ...(one.unit === "" ? [] : [h("small", {}, one.unit)])),
    h("td", {}, one.value === null ? (one.unstated ?? "") : fixed(one.value, one.decimals), ...interval(one).map((text) => h("small", {}, text))),
    h("td", {}, one.robust, ...(one.keeps === null ? [] : [h("small", {}, one.keeps ? "kept" : "not kept")])),
  ));
  return h("table", { class: "limits" }, h("thead", {}, h("tr", {}, ...heads)), h("tbody", {}, ...rows));
}

function interval({ low, high, decimals }: Margin): string[] {
  if (low === null) return [];
  return [high === null ? `from ${fixed(low, decimals)}` : `${fixed(low, decimals)} to ${fixed(high, decimals)}`];
}
