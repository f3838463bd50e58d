// Numbers and times as text. Pure.

/** Text for an unknown number. */
export const UNKNOWN = "--";

/** A number with a fixed count of decimals; a large one has fewer. */
export function fixed(value: number | null, digits: number): string {
  if (value === null || !Number.isFinite(value)) return UNKNOWN;
  const text = value.toFixed(Math.abs(value) >= 100 ? 0 : digits);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

/** A setting as typed: without the noise of a 32-bit float. */
export function plain(value: number): string {
  return String(Number(value.toPrecision(6)));
}

/** I:E as the field writes it, from the ratio of expiratory to inspiratory time. */
export function ratio(ie: number | null): string {
  if (ie === null || !(ie > 0)) return UNKNOWN;
  return ie >= 1 ? `1:${ie.toFixed(1)}` : `${(1 / ie).toFixed(1)}:1`;
}

/** A name of the code in words: `inspiratory_time` is "Inspiratory time"; PIP and PEEP are abbreviations. A text with blanks keeps its signs. */
export function words(name: string): string {
  const text = (name.includes(" ") ? name : name.replace(/[_-]/g, " ")).replace(/\b(pip|peep|pid)\b/g, (word) => word.toUpperCase());
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** A text as a sentence: a capital letter before it and a full stop after it. */
export function sentence(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".");
}

/** The mark of a device that is not a board: a replay must not look live. Empty for a board. */
export function origin(kind: string): string {
  if (kind === "recording") return "REPLAY";
  return kind === "simulated" ? "SIMULATED" : "";
}

/** A count with a blank between thousands. */
export function count(value: number): string {
  return Math.round(value).toString().replace(/\B(?=(\d{3})+$)/g, " ");
}
