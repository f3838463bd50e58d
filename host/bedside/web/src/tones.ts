// Alarm tones: the pulses of a burst for each priority, as IEC 60601-1-8 has them; the device's sounder uses the same patterns
// (shared/src/device/annunciator.rs).
//
// | priority | pulses | interval between bursts |
// |---|---|---|
// | high | 10 of 150 ms: 3 + 2, twice | 4 s |
// | medium | 3 of 200 ms | 8 s |
// | low | 2 of 200 ms | 20 s |

import type { Priority } from "./stream";

interface Pattern {
  /** Length of a pulse, s. */
  pulse: number;
  /** Silence after each pulse but the last, s. */
  gaps: readonly number[];
  /** Silence between two bursts, s. */
  interval: number;
  /** Fundamental frequency, Hz. */
  pitch: number;
}

export const PATTERNS: Record<Priority, Pattern> = {
  high: { pulse: 0.15, gaps: [0.1, 0.1, 0.35, 0.1, 0.7, 0.1, 0.1, 0.35, 0.1], interval: 4, pitch: 660 },
  medium: { pulse: 0.2, gaps: [0.2, 0.2], interval: 8, pitch: 520 },
  low: { pulse: 0.2, gaps: [0.2], interval: 20, pitch: 400 },
};

/** Relative strengths of the fundamental and its harmonics: the standard asks for at least four between 300 and 4000 Hz. */
export const HARMONICS = [1, 0.7, 0.6, 0.5, 0.4] as const;

/** Start times of a burst's pulses, s since its start. */
export function pulses(priority: Priority): number[] {
  const { pulse, gaps } = PATTERNS[priority];
  const starts = [0];
  for (const gap of gaps) starts.push((starts.at(-1) ?? 0) + pulse + gap);
  return starts;
}

/** Time from the start of a burst to that of the next one, s. */
export function repeat(priority: Priority): number {
  const { pulse, interval } = PATTERNS[priority];
  return (pulses(priority).at(-1) ?? 0) + pulse + interval;
}

const URGENCY: Record<Priority, number> = { high: 3, medium: 2, low: 1 };

/** How urgent a priority is: 3 for high, 0 for none. */
export function urgency(priority: Priority | null): number {
  return priority === null ? 0 : URGENCY[priority];
}
