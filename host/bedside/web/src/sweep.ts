// Geometry of the erase-bar sweep: where a sample stands, which samples form one line, what the bar erases. Pure.
//
// The place of a sample depends on its tick alone, so that a picture drawn again is the same picture.

import type { Ring } from "./ring";

/** Lengths of the sweep, s. */
export const SWEEPS = [6, 12, 30] as const;
/** Width of the erase bar as a part of the sweep. */
export const BAR = 0.025;

/** The sweep: its length and the device's tick, both in s. */
export interface Sweep {
  seconds: number;
  tick: number;
}

/** Place of a tick, 0 at the left to 1 at the right. */
export function place(tick: number, sweep: Sweep): number {
  const passes = (tick * sweep.tick) / sweep.seconds;
  return passes - Math.floor(passes);
}

/** Ticks that the sweep shows at once: all but the erase bar. */
export function shown(sweep: Sweep): number {
  return Math.floor(((1 - BAR) * sweep.seconds) / sweep.tick);
}

/** Index of the first sample that the sweep still shows. */
export function firstShown(ring: Ring, sweep: Sweep): number {
  return ring.find(ring.newest - shown(sweep) + 1);
}

/** A line of consecutive samples, indices from `begin` to before `end`. */
export interface Run {
  begin: number;
  end: number;
}

/** The lines in a range of samples: a new one begins at the left edge and after lost samples. */
export function runs(ring: Ring, begin: number, end: number, sweep: Sweep): Run[] {
  const found: Run[] = [];
  let from = begin;
  for (let index = begin + 1; index < end; index++) {
    const [before, now] = [ring.tickAt(index - 1), ring.tickAt(index)];
    if (now - before === 1 && place(now, sweep) > place(before, sweep)) continue;
    found.push({ begin: from, end: index });
    from = index;
  }
  if (end > from) found.push({ begin: from, end });
  return found;
}

/** The spans that the bar has moved over since it stood at `before`: pairs of places, left and right. */
export function erased(before: number, now: number): [number, number][] {
  const [left, right] = [(before + BAR) % 1, (now + BAR) % 1];
  if (left === right) return [];
  return left < right ? [[left, right]] : [[left, 1], [0, right]];
}

/** The sample under a place of the picture; null if the bar is there. */
export function sampleAt(ring: Ring, at: number, sweep: Sweep): number | null {
  if (Number.isNaN(ring.newest)) return null;
  const head = place(ring.newest, sweep);
  const back = (((head - at) % 1) + 1) % 1;
  const tick = Math.round(ring.newest - (back * sweep.seconds) / sweep.tick);
  const index = ring.find(tick);
  return tick > ring.newest - shown(sweep) && index < ring.end && ring.tickAt(index) === tick ? index : null;
}
