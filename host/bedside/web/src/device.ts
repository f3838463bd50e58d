// One device: its newest state and breath, its samples, its trends, and the times at which it was last heard.

import { deviceLost, lacks, noData } from "./alarms";
import { Reference } from "./reference";
import { KEPT_S, Ring } from "./ring";
import { type Marker, MARKERS } from "./markers";
import type { Alarm, Breath, DeviceInfo, Event, FlightRecorder, Margins, Samples, State, Verdict } from "./stream";
import { Trends } from "./trends";

/**
 * Longest silence of a device or of the whole connection, ms, so that the page reports it within a second. The server sends a state at
 * least every 250 ms: two late ones are no alarm.
 */
export const SILENCE_MS = 900;
/** Figures of a breath are old after this many breaths at the set rate. */
const CURRENT_BREATHS = 2;
/** Rate if none is known, 1/min: the lowest that can be set. */
const SLOWEST = 4;
/** Events kept. */
const EVENTS = 200;

export class Device {
  state: State | null = null;
  breath: Breath | null = null;
  /** When its last breath came: by performance.now(), and Unix ms. */
  private breathHeard = 0;
  breathTime = 0;
  reference: Reference | null = null;
  /** The same lung under the other controller, PID or learned. */
  partner: Device | null = null;
  readonly trends = new Trends();
  readonly events: Event[] = [];
  /** Markers by their ticks, the newest last. */
  readonly markers: Marker[] = [];
  /** The verdict on a recording. */
  verdict: Verdict | null = null;
  /** The content of its flight recorder, once that was read. */
  recorder: FlightRecorder | null = null;
  /** Its margins, once they are measured. */
  margins: Margins | null = null;
  /** Whether this page wants the samples. */
  watched = false;
  /** Whether this page steers it. */
  yours = false;
  /** Samples that the server did not send because this page was too slow. */
  dropped = 0;
  /** Time of the server at the last sample, Unix ms. */
  time_ms = 0;
  /** When its samples and its states came last, by performance.now(). Samples that became due later are counted from then. */
  private samplesHeard = performance.now();
  private stateHeard = performance.now();
  private samples: Ring | null = null;
  /** When the page's own alarms began, Unix ms. */
  private silentSince: number | null = null;
  /** Whether only its samples are missing. */
  private statesArrive = false;
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
    const due = this.samplesDue;
    this.state = state;
    this.stateHeard = now;
    if (this.samplesDue && !due) this.samplesHeard = now;
    this.lostSince = state.connected ? null : (this.lostSince ?? Date.now());
  }

  takeSamples(samples: Samples, now: number): void {
    // A recording that begins again has the same moments at the same ticks.
    if (this.ring.push(samples) && !this.replay) this.restarted(samples.time_ms);
    this.dropped = samples.dropped;
    this.time_ms = samples.time_ms;
    this.samplesHeard = now;
  }

  takeBreath(breath: Breath, now: number): void {
    this.breath = breath;
    this.breathHeard = now;
    // The time of the newest sample is current only while the device is watched.
    this.breathTime = breath.time_ms ?? (this.watched && this.time_ms > 0 ? this.time_ms : Date.now());
    this.trends.add(this.breathTime, breath);
  }

  takeEvent(event: Event): void {
    // After a reconnection the server sends the newest events again.
    const known = (one: Event) => one.time_ms === event.time_ms && one.kind === event.kind && one.text === event.text;
    if (this.events.some(known)) return;
    this.events.unshift(event);
    this.events.length = Math.min(this.events.length, EVENTS);
    if (event.kind === "restarted") this.restarted(event.time_ms);
    if (event.kind !== "marker") return;
    const tick = event.tick ?? this.samples?.newest ?? Number.NaN;
    if (!Number.isNaN(tick)) this.markers.push({ tick, text: event.text, time_ms: event.time_ms });
    if (this.markers.length > MARKERS) this.markers.shift();
  }

  /** Forgets what was before a restart: the device counts its ticks from zero again, and its last breath is not of this start. */
  private restarted(time_ms: number): void {
    const kept = this.markers.filter((marker) => marker.time_ms > time_ms);
    this.markers.splice(0, this.markers.length, ...kept);
    if (this.breathTime <= time_ms) this.breath = null;
  }

  /** Begins or ends watching the samples; those that pass meanwhile do not count as missing. */
  watch(on: boolean): void {
    if (on && !this.watched) {
      this.samples?.resume();
      this.samplesHeard = performance.now();
    }
    this.watched = on;
  }

  /** Keeps the last complete breath as the reference, or forgets it. */
  keepReference(): boolean {
    this.reference = this.reference === null ? Reference.take(this.ring) : null;
    return this.reference !== null;
  }

  /** Whether it is a replay, which pauses before it starts again and has no patient. */
  get replay(): boolean {
    return this.info.kind === "recording";
  }

  /** Whether it ventilates and its line is not lost, so that its samples must come. */
  private get samplesDue(): boolean {
    return this.state?.ventilating === true && (this.state.connected || this.state.missing === "answers");
  }

  /** Whether it may be ventilating: a device whose mode is not known may. */
  private get mayVentilate(): boolean {
    return !this.replay && (this.state === null || this.state.mode === "" || this.state.ventilating);
  }

  /** Time for which its states or samples have been missing, ms: one kind does not hide that the other is missing, and alarms are in the states. */
  silence(now: number): number {
    const samplesNeeded = this.watched && !this.replay && this.samplesDue;
    return now - (samplesNeeded ? Math.min(this.samplesHeard, this.stateHeard) : this.stateHeard);
  }

  /** Whether nothing has arrived for too long; `connectionSilence` is the silence of the whole connection, ms. */
  silent(now: number, connectionSilence: number): boolean {
    const silent = Math.max(this.silence(now), connectionSilence) > SILENCE_MS;
    this.silentSince = silent ? (this.silentSince ?? Date.now()) : null;
    this.statesArrive = connectionSilence <= SILENCE_MS && now - this.stateHeard <= SILENCE_MS;
    return silent;
  }

  /** Whether the figures of the last breath are not those of now: nothing arrives, it does not ventilate, or breaths fail to come. */
  old(now: number): boolean {
    if (this.breath === null) return false;
    if (this.silentSince !== null || (!this.replay && !this.samplesDue)) return true;
    const rates = [this.state?.settings.rate, this.breath.rate_set].filter((rate) => rate != null && rate > 0) as number[];
    const rate = rates.length > 0 ? Math.min(...rates) : SLOWEST;
    return now - this.breathHeard > (CURRENT_BREATHS * 60_000) / rate;
  }

  /** The text that covers its curves when they are not live, or null. Call `silent` before. */
  cover(): string | null {
    if (this.silentSince !== null) return "No data";
    // Samples may arrive although answers do not.
    if (this.state?.connected === false && this.state.missing !== "answers") return lacks(this.state);
    return null;
  }

  /** The alarms that the page raises itself. Call `silent` before. */
  own(): Alarm[] {
    if (this.silentSince !== null) return [noData(this.mayVentilate, this.silentSince, this.statesArrive ? "No samples from the device" : undefined)];
    if (this.state === null || this.state.connected) return [];
    return [deviceLost(this.state, this.mayVentilate, this.lostSince ?? Date.now())];
  }

  /** The device's alarms and those of the page. */
  alarms(): Alarm[] {
    return [...this.own(), ...(this.state?.alarms ?? [])];
  }
}
