// Figures of the breaths over 72 hours in buckets of a minute: lowest, mean and highest. Pure; memory is fixed.

import type { Breath, Figure, History } from "./stream";

/** Length of a bucket, ms: a minute, as the server's. */
export const BUCKET_MS = 60_000;
/** Number of buckets: 72 hours. */
export const BUCKETS = (72 * 3_600_000) / BUCKET_MS;
/** Figures with a trend. */
export const TRENDED = [
  "pip", "plateau", "peep", "tidal_volume", "minute_volume", "rate", "resistance", "compliance", "error", "overshoot",
] as const satisfies readonly Figure[];
export type Trended = (typeof TRENDED)[number];

/** A line over time: Unix times in s, and the lowest, mean and highest value; null where no breath was. */
export interface Series {
  time: number[];
  low: (number | null)[];
  mean: (number | null)[];
  high: (number | null)[];
}

interface Column {
  low: Float32Array;
  high: Float32Array;
  sum: Float32Array;
  count: Uint16Array;
}

/** Values of one figure in one bucket. */
interface Values {
  low: number;
  mean: number;
  high: number;
  count: number;
}

export class Trends {
  private readonly columns: Record<Trended, Column>;
  /** Number of the newest bucket since 1970; 0 before the first breath. */
  newest = 0;
  private oldest = 0;

  constructor() {
    const column = (): Column => ({
      low: new Float32Array(BUCKETS), high: new Float32Array(BUCKETS),
      sum: new Float32Array(BUCKETS), count: new Uint16Array(BUCKETS),
    });
    this.columns = Object.fromEntries(TRENDED.map((name) => [name, column()])) as Record<Trended, Column>;
  }

  /** Adds the figures of a breath. A time that lies before the newest bucket is counted to the newest. */
  add(time_ms: number, breath: Breath): void {
    const bucket = Math.max(Math.floor(time_ms / BUCKET_MS), this.newest);
    this.reach(bucket);
    for (const name of TRENDED) put(this.columns[name], bucket % BUCKETS, breath[name]);
  }

  /** Takes what the server knows of the time before; a bucket with more breaths here is kept, as after the server's restart. */
  load(history: History): void {
    for (const [index, bucket] of history.minutes.entries()) {
      if (this.newest === 0 || bucket > this.newest) this.reach(bucket);
      if (bucket <= this.newest - BUCKETS) continue;
      this.oldest = Math.min(this.oldest, bucket);
      for (const name of TRENDED) {
        const values = entry(history, name, index);
        if (values) replace(this.columns[name], bucket % BUCKETS, values);
      }
    }
  }

  /** Goes on to a bucket. Those on the way are emptied, at most once round. */
  private reach(bucket: number): void {
    if (this.newest === 0) this.oldest = bucket;
    for (let empty = Math.max(this.newest + 1, bucket - BUCKETS + 1); empty <= bucket; empty++) this.clear(empty % BUCKETS);
    this.newest = bucket;
    this.oldest = Math.max(this.oldest, bucket - BUCKETS + 1);
  }

  private clear(place: number): void {
    for (const name of TRENDED) this.columns[name].count[place] = 0;
  }

  /** The line of a figure over the last hours, in at most `points` points; points that merge keep their extremes. */
  series(name: Trended, hours: number, points = 600): Series {
    const series: Series = { time: [], low: [], mean: [], high: [] };
    if (this.newest === 0) return series;
    const span = Math.min((hours * 3_600_000) / BUCKET_MS, BUCKETS);
    const first = Math.max(this.newest - span + 1, this.oldest);
    const step = Math.max(1, Math.ceil(span / points));
    for (let bucket = first - (first % step); bucket <= this.newest; bucket += step) {
      const merged = merge(this.columns[name], Math.max(bucket, first), Math.min(bucket + step - 1, this.newest));
      series.time.push((bucket * BUCKET_MS) / 1000);
      series.low.push(merged?.low ?? null);
      series.mean.push(merged?.mean ?? null);
      series.high.push(merged?.high ?? null);
    }
    return series;
  }
}

function put(column: Column, place: number, value: number | null): void {
  if (value === null) return;
  const known = column.count[place] ?? 0;
  if (known === 65_535) return;
  column.low[place] = known === 0 ? value : Math.min(column.low[place] ?? value, value);
  column.high[place] = known === 0 ? value : Math.max(column.high[place] ?? value, value);
  column.sum[place] = known === 0 ? value : (column.sum[place] ?? 0) + value;
  column.count[place] = known + 1;
}

/** One figure in one minute of the server's history; null where it is not known. */
function entry({ figures, breaths }: History, name: Trended, index: number): Values | null {
  const course = figures[name];
  const [low, mean, high] = [course?.low[index] ?? null, course?.mean[index] ?? null, course?.high[index] ?? null];
  return low === null || mean === null || high === null ? null : { low, mean, high, count: breaths[index] ?? 1 };
}

function replace(column: Column, place: number, { low, mean, high, count }: Values): void {
  if ((column.count[place] ?? 0) > count) return;
  column.low[place] = low;
  column.high[place] = high;
  column.sum[place] = mean * count;
  column.count[place] = count;
}

function merge(column: Column, first: number, last: number): { low: number; mean: number; high: number } | null {
  let [low, high, sum, count] = [Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY, 0, 0];
  for (let bucket = first; bucket <= last; bucket++) {
    const place = bucket % BUCKETS;
    const here = column.count[place] ?? 0;
    if (here === 0) continue;
    low = Math.min(low, column.low[place] ?? low);
    high = Math.max(high, column.high[place] ?? high);
    sum += column.sum[place] ?? 0;
    count += here;
  }
  return count === 0 ? null : { low, mean: sum / count, high };
}
