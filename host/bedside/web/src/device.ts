// What the page knows of one device: its newest state and breath, its samples, its trends, and when it was last heard.

import { deviceLost, noData } from "./alarms";
import { Reference } from "./reference";
import { KEPT_S, Ring } from "./ring";
import type { Alarm, Breath, DeviceInfo, Event, Samples, State } from "./stream";
import { Trends } from "./trends";

/** Longest silence of a device whose samples are watched, or of the whole connection, ms. */
export const SILENCE_MS = 950;
/** Longest silence of a device of which only states come, ms: one late heartbeat is no alarm. */
export const SILENCE_OF_STATES_MS = 2_500;
/** Events kept. */
const EVENTS = 200;

export class Device {
  state: State | null = null;
  breath: Breath | null = null;
  reference: Reference | null = null;
  /** The same lung under the other controller, PID or learned. */
  partner: Device | null = null;
  readonly trends = new Trends();
  readonly events: Event[] = [];
  /** Whether this page wants the samples. */
  watched = false;
  /** Whether this page steers it. */
  yours = false;
  /** Samples that the server did not send because this page was too slow. */
  dropped = 0;
  /** Time of the server at the last sample, Unix ms. */
  time_ms = 0;
  private heard = performance.now();
  private samples: Ring | null = null;
  /** When the page's own alarms began, Unix ms. */
  private silentSince: number | null = null;
  private lostSince: number | null = null;

  constructor(public info: DeviceInfo) {}

  /** The samples; memory is taken at the first use. */
  get ring(): Ring {
    this.samples ??= new Ring(Math.ceil(KEPT_S / this.tick));
    return this.samples;
  }

  /** Length of a tick, s. */
  get tick(): number {
    return this.info.period_us * 1e-6;
  }

  takeState(state: State, now: number): void {
    this.state = state;
    this.heard = now;
    this.lostSince = state.connected ? null : (this.lostSince ?? Date.now());
  }

  takeSamples(samples: Samples, now: number): void {
    this.ring.push(samples);
    this.dropped = samples.dropped;
    this.time_ms = samples.time_ms;
    this.heard = now;
  }

  takeBreath(breath: Breath): void {
    this.breath = breath;
    this.trends.add(this.time_ms || Date.now(), breath);
  }

  takeEvent(event: Event): void {
    this.events.unshift(event);
    this.events.length = Math.min(this.events.length, EVENTS);
  }

  /** Begins or ends watching the samples; those that pass meanwhile do not count as missing. */
  watch(on: boolean): void {
    if (on && !this.watched) this.samples?.resume();
    // Samples that are asked for only now are not late yet.
    if (on && !this.watched) this.heard = Math.max(this.heard, performance.now() - SILENCE_MS / 2);
    this.watched = on;
  }

  /** Keeps the last complete breath as the reference, or forgets it. */
  keepReference(): boolean {
    this.reference = this.reference === null ? Reference.take(this.ring) : null;
    return this.reference !== null;
  }

  /** Time since anything was heard of it, ms. */
  silence(now: number): number {
    return now - this.heard;
  }

  /** Whether nothing has arrived for too long; `connectionSilence` is the silence of the whole connection, ms. */
  silent(now: number, connectionSilence: number): boolean {
    const limit = this.watched ? SILENCE_MS : SILENCE_OF_STATES_MS;
    const silent = this.silence(now) > limit || connectionSilence > SILENCE_MS;
    this.silentSince = silent ? (this.silentSince ?? Date.now()) : null;
    return silent;
  }

  /** The alarms that the page raises itself. Call `silent` before. */
  own(): Alarm[] {
    const ventilating = this.state?.ventilating ?? false;
    if (this.silentSince !== null) return [noData(ventilating, this.silentSince)];
    if (this.state === null || this.state.connected) return [];
    return [deviceLost(this.state.lost, ventilating, this.lostSince ?? Date.now())];
  }

  /** The device's alarms and those of the page. */
  alarms(): Alarm[] {
    return [...this.own(), ...(this.state?.alarms ?? [])];
  }
}
