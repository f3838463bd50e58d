// The panel for recordings, markers and triggered captures, and the log of events.

import { clock } from "./alarms";
import type { Device } from "./device";
import { button, h, setAttribute, setText, show } from "./dom";
import { count, plain, words } from "./format";
import type { Requests } from "./requests";
import type { LogLine, State, Triggers } from "./stream";

export class Record {
  readonly element = h("div", { class: "record" });
  private readonly status = h("p", { role: "status" });
  private readonly result = h("p", { class: "result", role: "status", "aria-live": "polite" });
  private readonly log = h("ol", { class: "log", "aria-label": "Events, the newest first" });
  private readonly none = h("p", { class: "quiet" }, "No events yet.");
  private readonly recorder = h("ol", { class: "log", "aria-label": "Events of the flight recorder, the newest first" });
  private readonly noRecorder = h("p", { class: "quiet" }, "Not read yet.");
  private readonly read = button("Read the flight recorder", () => this.readRecorder());
  private shownLog: readonly LogLine[] | null = null;
  private readonly toggle = button("Start recording", () => this.record());
  private readonly text = h("input", { id: "marker-text", type: "text", maxlength: "200", placeholder: "for example: lung changed" });
  private readonly overshoot = h("input", { id: "capture-overshoot", type: "text", inputmode: "decimal", placeholder: "off" });
  private readonly pressure = h("input", { id: "capture-pressure", type: "text", inputmode: "decimal", placeholder: "off" });
  private readonly alarm = h("input", { id: "capture-alarm", type: "checkbox" });
  private readonly armed = h("p", { class: "armed", role: "status" });
  private readonly disarm = button("Disarm", () => this.ask("capture", { triggers: {} }));
  private device: Device | null = null;
  private known = "";

  constructor(private readonly requests: Requests) {
    const field = (label: string, input: HTMLElement, unit = "") => h("label", { class: "field" }, h("span", {}, label), input, unit);
    const marker = h("form", { class: "row", onsubmit: (event) => { event.preventDefault(); this.mark(); } },
      field("Text", this.text), h("button", { type: "submit" }, "Set marker"));
    const capture = h("form", { onsubmit: (event) => { event.preventDefault(); this.capture(); } },
      field("On overshoot above", this.overshoot, "cmH2O"), field("On pressure above", this.pressure, "cmH2O"), field("On an alarm", this.alarm),
      h("div", { class: "row" }, h("button", { type: "submit" }, "Arm capture"), this.disarm));
    this.element.append(
      h("h2", {}, "Recording"), this.status, h("div", { class: "row" }, this.toggle), this.result,
      h("h2", {}, "Marker"), marker,
      h("h2", {}, "Capture, with the 10 s before"), this.armed, capture,
      h("h2", {}, "Events"), this.none, this.log,
      h("h2", {}, "Flight recorder"), h("div", { class: "row" }, this.read), this.noRecorder, this.recorder,
    );
  }

  update(device: Device): void {
    if (this.device !== device) setText(this.result, "");
    this.device = device;
    const recording = device.state?.recording ?? null;
    setText(this.status, recording ? recordingInWords(recording) : "Not recording.");
    setText(this.toggle, recording ? "Stop recording" : "Start recording");
    const capture = device.state?.triggers ?? null;
    setText(this.armed, capture ? `Armed: ${triggersInWords(capture)}.` : "Not armed.");
    this.disarm.disabled = capture === null;
    this.updateRecorder(device);
    const now = `${device.info.id} ${device.events.length} ${device.events[0]?.time_ms} ${device.events[0]?.text}`;
    if (now === this.known) return;
    this.known = now;
    show(this.none, device.events.length === 0);
    this.log.replaceChildren(...device.events.map(({ time_ms, kind, text }) =>
      h("li", {}, h("time", {}, clock(time_ms)), " ", h("b", {}, words(kind)), ` ${text}`)));
  }

  private updateRecorder(device: Device): void {
    // A replay has its log from the start, or none.
    show(this.read, device.info.kind !== "recording");
    show(this.noRecorder, device.log === null);
    setText(this.noRecorder, device.info.kind === "recording" ? "This recording has no event log." : "Not read yet.");
    if (device.log === this.shownLog) return;
    this.shownLog = device.log;
    const newest = [...(device.log ?? [])].reverse();
    this.recorder.replaceChildren(...newest.map(({ start, seconds, text }) =>
      h("li", {}, h("time", {}, `start ${start}, ${seconds.toFixed(3)} s`), ` ${text}`)));
  }

  private async readRecorder(): Promise<void> {
    await this.ask("recorder", {});
  }

  /** Sets a marker with the typed text. */
  async mark(): Promise<void> {
    const text = this.text.value.trim() || "marker";
    if (await this.ask("mark", { text })) this.text.value = "";
  }

  private async record(): Promise<void> {
    await this.ask("record", { on: this.device?.state?.recording == null });
  }

  private async capture(): Promise<void> {
    const [overshoot, pressure] = [this.level("overshoot", this.overshoot), this.level("pressure", this.pressure)];
    if (overshoot === undefined || pressure === undefined) return;
    const triggers = { overshoot, pressure, alarm: this.alarm.checked };
    if (overshoot === null && pressure === null && !triggers.alarm) this.refuse("choose a trigger first", this.overshoot);
    else await this.ask("capture", { triggers });
  }

  /** The level in a field, null if it is empty; undefined if it is wrong, which is told, and the field is in focus. */
  private level(name: string, input: HTMLInputElement): number | null | undefined {
    const text = input.value.trim().replace(",", ".");
    const value = Number(text);
    const wrong = text !== "" && !(value > 0 && Number.isFinite(value));
    setAttribute(input, "aria-invalid", wrong ? "true" : null);
    if (wrong) return this.refuse(`${name}: enter a number above 0, or nothing`, input);
    return text === "" ? null : value;
  }

  private refuse(reason: string, input: HTMLInputElement): undefined {
    setText(this.result, `Refused: ${reason}.`);
    setAttribute(this.result, "data-ok", "false");
    input.focus();
  }

  private async ask(type: string, content: object): Promise<boolean> {
    if (this.device === null) return false;
    const answer = await this.requests.ask(type, this.device.info.id, content);
    setText(this.result, answer.ok ? answer.text || "Done." : `Refused: ${answer.text}`);
    setAttribute(this.result, "data-ok", String(answer.ok));
    return answer.ok;
  }
}

/** The recording in words. */
export function recordingInWords({ file, samples, lost, by }: NonNullable<State["recording"]>): string {
  const losses = lost > 0 ? `, ${count(lost)} lost because the disk is too slow` : "";
  return `Recording to ${file}: ${count(samples)} samples${losses}${by === null ? "" : `, started by ${by}`}`;
}

/** The armed triggers in words. */
export function triggersInWords({ alarm, overshoot, pressure }: Triggers): string {
  const level = (name: string, value: number | null) => (value === null ? [] : [`${name} above ${plain(value)} cmH2O`]);
  return [...level("overshoot", overshoot), ...level("pressure", pressure), ...(alarm ? ["an alarm"] : [])].join(", ");
}
