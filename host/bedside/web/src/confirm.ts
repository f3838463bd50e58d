// Rules for changes: the bounds of typed values, and what needs a confirmation: large changes, and control that another has. Pure.

import { plain, words } from "./format";
import type { Setting, State, Values } from "./stream";

/** How a state names the page's own server as the holder of the device's lease. */
const OWN_SERVER = "this server";

/** A typed value: a number within the bounds, or the reason why not. */
export type Typed = { value: number } | { reason: string };

/** Reads the text that was typed for a setting. */
export function typed(setting: Setting, text: string): Typed {
  const trimmed = text.trim().replace(",", ".");
  const value = trimmed === "" ? Number.NaN : Number(trimmed);
  // The bounds as printed: 0.2 is not below a bound that a 32-bit float makes 0.20000000298.
  const [min, max] = [plain(setting.min), plain(setting.max)];
  const bounds = `${min} to ${max} ${setting.unit}`;
  if (!(value >= Number(min) && value <= Number(max))) return { reason: `${words(setting.name)}: enter a number from ${bounds}` };
  return { value };
}

/** The settings that differ from the applied ones. */
export function changes(settings: readonly Setting[], applied: Values, asked: Values): Setting[] {
  return settings.filter(({ name }) => {
    const [from, to] = [applied[name], asked[name]];
    return to !== undefined && (from === undefined || plain(from) !== plain(to));
  });
}

/** The changes of a pressure by more than `limit` cmH2O, one sentence each; none means that no confirmation is needed. */
export function large(settings: readonly Setting[], applied: Values, asked: Values, limit: number): string[] {
  return changes(settings, applied, asked)
    .filter(({ name, unit }) => unit === "cmH2O" && !(Math.abs((asked[name] ?? 0) - (applied[name] ?? Number.NaN)) <= limit))
    .map(({ name, unit }) => `${words(name)} from ${plain(applied[name] ?? Number.NaN)} to ${plain(asked[name] ?? 0)} ${unit}`);
}

/** Who else steers a device: a page, or a program that holds the device's lease past all pages. */
export function steerers(state: Pick<State, "steered_by" | "lease"> | null): string[] {
  return [state?.steered_by, state?.lease].filter((who) => typeof who === "string" && who !== OWN_SERVER) as string[];
}
