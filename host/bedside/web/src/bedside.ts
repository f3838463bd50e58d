// The view of one device: waveforms, panel, numbers, and the bar of tools below.

import { AlarmList, without } from "./alarm_view";
import type { Device } from "./device";
import { button, h, setAttribute, setText } from "./dom";
import { Loops } from "./loops";
import { Numbers } from "./numbers";
import { Record } from "./record";
import type { Requests } from "./requests";
import type { Measure } from "./stream";
import { Steer } from "./steer";
import { SWEEPS } from "./sweep";
import { type Tab, Tabs } from "./tabs";
import { TrendCharts } from "./trends_view";
import { Tuning } from "./tuning";
import { VerdictPanel } from "./verdict_view";
import { Waves } from "./waves";

export class Bedside {
  readonly element: HTMLElement;
  readonly waves = new Waves();
  readonly steer: Steer;
  readonly record: Record;
  private readonly numbers = new Numbers();
  private readonly loops = new Loops();
  private readonly trends = new TrendCharts();
  private readonly alarms = new AlarmList();
  private readonly verdict = new VerdictPanel();
  private readonly tuning: Tuning;
  private readonly tabs: Tabs;
  private readonly tools: HTMLElement;
  private readonly freezeButton = button("Freeze", () => this.freeze(), { "aria-pressed": "false", class: "freeze" });
  private readonly referenceButton = button("Keep reference", () => this.reference(), { "aria-pressed": "false" });
  private readonly note = h("span", { class: "note", role: "status" });
  private readonly sweeps: HTMLButtonElement[];
  private device: Device | null = null;
  private canMeasure = false;

  constructor(requests: Requests, send: (message: object) => boolean, extra: HTMLElement) {
    this.steer = new Steer(requests, send);
    this.record = new Record(requests);
    this.tuning = new Tuning(requests);
    this.tabs = new Tabs(this.pages());
    this.sweeps = SWEEPS.map((seconds) => button(`${seconds} s`, () => this.setSeconds(seconds), { "aria-pressed": "false", "data-seconds": String(seconds) }));
    const sweeps = h("div", { class: "sweeps", role: "group", "aria-label": "Length of the sweep" }, ...this.sweeps);
    this.tools = h("div", { class: "tools", role: "group", "aria-label": "Tools" }, this.freezeButton, sweeps, this.referenceButton, extra, this.note);
    this.element = h("div", { class: "bedside" }, this.waves.element, this.tabs.element, this.numbers.element, this.tools);
    this.setSeconds(12);
  }

  /** `measure` is what a measurement may ask for; null if none can be made. */
  describe(measure: Measure | null): void {
    this.tuning.describe(measure);
    this.canMeasure = measure !== null;
  }

  setDevice(device: Device): void {
    this.device = device;
    this.waves.setDevice(device);
    this.buttons();
  }

  /** The view is left: when it is opened again, its picture runs. */
  leave(): void {
    this.waves.freeze(false);
    this.buttons();
  }

  /** Updates texts and numbers. */
  update(mayEver: { steer: boolean; record: boolean }, now: number): void {
    const { device } = this;
    if (device === null) return;
    const cover = device.cover();
    this.numbers.update(device, now);
    this.alarms.update(device.alarms(), without([device]));
    this.steer.update(device, mayEver.steer);
    this.record.update(device, mayEver.record);
    this.verdict.update(device);
    this.tuning.update(device, mayEver.steer);
    this.tabs.offer("tuning", this.canMeasure && !device.replay);
    this.tabs.offer("verdict", device.verdict !== null);
    this.waves.cover(cover);
    this.element.classList.toggle("stale", cover !== null);
  }

  /** Draws curves; the oldest tick that is new in the picture, or null. */
  draw(now: number): number | null {
    if (this.device === null) return null;
    const drawn = this.waves.draw(now);
    this.loops.draw(now, this.waves.ring, this.device);
    this.trends.draw(now, this.device);
    return drawn;
  }

  freeze(): void {
    this.waves.freeze(!this.waves.isFrozen);
    this.buttons();
  }

  /** Keeps the last breath as the reference, or forgets it. */
  reference(): void {
    if (this.device === null) return;
    const had = this.device.reference !== null;
    const has = this.device.keepReference();
    setText(this.note, had ? "Reference forgotten." : has ? "Reference kept: the last breath." : "No complete breath yet.");
    this.waves.redraw();
    this.buttons();
  }

  setSeconds(seconds: number): void {
    this.waves.setSeconds(seconds);
    for (const one of this.sweeps) setAttribute(one, "aria-pressed", String(one.dataset.seconds === String(seconds)));
  }

  /** The next length of the sweep. */
  nextSweep(): void {
    const now = this.sweeps.findIndex((one) => one.getAttribute("aria-pressed") === "true");
    this.setSeconds(SWEEPS[(now + 1) % SWEEPS.length] ?? SWEEPS[0]);
  }

  /** Opens a page of the panel. */
  open(id: string): void {
    this.tabs.focus(id);
  }

  private buttons(): void {
    const { isFrozen } = this.waves;
    setAttribute(this.freezeButton, "aria-pressed", String(isFrozen));
    setText(this.freezeButton, isFrozen ? "Run" : "Freeze");
    const kept = this.device?.reference != null;
    setAttribute(this.referenceButton, "aria-pressed", String(kept));
    setText(this.referenceButton, kept ? "Forget reference" : "Keep reference");
  }

  private pages(): Tab[] {
    return [
      { id: "loops", text: "Loops", content: this.loops.element },
      { id: "trends", text: "Trends", content: this.trends.element },
      { id: "alarms", text: "Alarms", content: this.alarms.element },
      { id: "settings", text: "Settings", content: this.steer.element },
      { id: "record", text: "Record", content: this.record.element },
      { id: "tuning", text: "Tuning", content: this.tuning.element },
      { id: "verdict", text: "Verdict", content: this.verdict.element },
    ];
  }
}
