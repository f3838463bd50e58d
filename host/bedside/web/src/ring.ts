// The newest samples of one device in arrays of fixed length, so that memory stays flat.
//
// A sample is found by its age in order of arrival; ticks tell gaps and restarts.

import { COLUMNS, type Column, type Samples } from "./stream";

/** Time kept, s: more than the longest sweep. */
export const KEPT_S = 32;

export class Ring {
  readonly columns: Record<Column, Float32Array>;
  readonly phase: Uint8Array;
  /** Tick of each sample. */
  readonly tick: Float64Array;
  /** Samples received in all; the newest has index `end - 1`. */
  end = 0;
  /** Index of the first sample since the device's last restart. */
  start = 0;
  /** Ticks that never arrived. */
  missing = 0;
  private next = Number.NaN;

  constructor(readonly length: number) {
    this.columns = Object.fromEntries(COLUMNS.map((name) => [name, new Float32Array(length)])) as Record<Column, Float32Array>;
    this.phase = new Uint8Array(length);
    this.tick = new Float64Array(length);
  }

  /** Index of the oldest sample that is still here. */
  get oldest(): number {
    return Math.max(this.start, this.end - this.length);
  }

  /** Tick of the newest sample; NaN if there is none. */
  get newest(): number {
    return this.end > this.oldest ? this.tickAt(this.end - 1) : Number.NaN;
  }

  tickAt(index: number): number {
    return this.tick[index % this.length] ?? Number.NaN;
  }

  phaseAt(index: number): number {
    return this.phase[index % this.length] ?? 0;
  }

  at(name: Column, index: number): number {
    return this.columns[name][index % this.length] ?? Number.NaN;
  }

  /**
   * Appends samples; returns whether the device or the recording has restarted, which a first tick that lies before the expected one
   * means.
   */
  push(samples: Samples): boolean {
    if (samples.tick > this.next) this.missing += samples.tick - this.next;
    const restarted = samples.tick < this.next;
    if (restarted) this.start = this.end;
    this.next = samples.tick + samples.count;
    for (let index = 0; index < samples.count; index++) {
      const place = (this.end + index) % this.length;
      for (const name of COLUMNS) this.columns[name][place] = samples.columns[name][index] ?? Number.NaN;
      this.phase[place] = samples.phase[index] ?? 0;
      this.tick[place] = samples.tick + index;
    }
    this.end += samples.count;
    return restarted;
  }

  /** Continues after a time without samples, which are not missing. */
  resume(): void {
    this.next = Number.NaN;
    // A device that restarted meanwhile counts its ticks from zero again, so older samples are forgotten.
    this.start = this.end;
  }

  /** The first index whose tick is not below `tick`, by bisection; `end` if there is none. */
  find(tick: number): number {
    let [low, high] = [this.oldest, this.end];
    while (low < high) {
      const middle = Math.floor((low + high) / 2);
      if (this.tickAt(middle) < tick) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** A copy that does not change any more, for a frozen picture. */
  copy(): Ring {
    const copy = new Ring(this.length);
    for (const name of COLUMNS) copy.columns[name].set(this.columns[name]);
    copy.phase.set(this.phase);
    copy.tick.set(this.tick);
    copy.end = this.end;
    copy.start = this.start;
    copy.missing = this.missing;
    copy.next = this.next;
    return copy;
  }

  /** Whether a breath starts at this sample: the first sample of an inspiration. */
  startsBreath(index: number): boolean {
    return this.phaseAt(index) === 0 && index > this.oldest && this.phaseAt(index - 1) !== 0;
  }

  /** Index at which the breath of the sample before `end` starts; null if that is not here any more. */
  breathBefore(end: number): number | null {
    for (let index = end - 1; index > this.oldest; index--) if (this.startsBreath(index)) return index;
    return null;
  }
}
