// The panel for recordings, markers and triggered captures, and the log of events.

import { clock } from "./alarms";
import type { Device } from "./device";
import { button, h, setAttribute, setText, show } from "./dom";
import { count, plain, words } from "./format";
import { RecorderView } from "./recorder_view";
import type { Requests } from "./requests";
import type { Recording, Triggers } from "./stream";

/** Longest time of reading a flight recorder, ms: some hundred requests. */
const READING_MS = 60_000;

export class Record {
  readonly element = h("div", { class: "record" });
  private readonly status = h("p", { role: "status" });
  private readonly result = h("p", { class: "result", role: "status", "aria-live": "polite" });
  private readonly log = h("ol", { class: "log", "aria-label": "Events, the newest first" });
  private readonly none = h("p", { class: "quiet" }, "No events yet.");
  private readonly recorder = new RecorderView(() => this.ask("recorder", {}, READING_MS));
  private readonly toggle = button("Start recording", () => this.record());
  private readonly text = h("input", { id: "marker-text", type: "text", maxlength: "200", placeholder: "for example: lung changed" });
  private readonly overshoot = h("input", { id: "capture-overshoot", type: "text", inputmode: "decimal", placeholder: "off" });
  private readonly pressure = h("input", { id: "capture-pressure", type: "text", inputmode: "decimal", placeholder: "off" });
  private readonly alarm = h("input", { id: "capture-alarm", type: "checkbox" });
  private readonly armed = h("p", { class: "armed", role: "status" });
  private readonly disarm = button("Disarm", () => this.ask("capture", { triggers: {} }));
  private readonly readOnly = h("p", { class: "quiet" }, "This page is read-only: start the server with --steer to record.");
  /** What asks for something; hidden if the server would refuse it. */
  private readonly controls: HTMLElement[];
  private device: Device | null = null;
  private known = "";

  constructor(private readonly requests: Requests) {
    const field = (label: string, input: HTMLElement, unit = "") => h("label", { class: "field" }, h("span", {}, label), input, unit);
    const marker = h("form", { class: "row", onsubmit: (event) => { event.preventDefault(); this.mark(); } },
      field("Text", this.text), h("button", { type: "submit" }, "Set marker"));
    const capture = h("form", { onsubmit: (event) => { event.preventDefault(); this.capture(); } },
      field("Overshoot above", this.overshoot, "cmH2O"), field("Pressure above", this.pressure, "cmH2O"), field("Any alarm", this.alarm),
      h("div", { class: "row" }, h("button", { type: "submit" }, "Arm capture"), this.disarm));
    const record = h("div", { class: "row" }, this.toggle);
    const setMarker = h("div", {}, h("h2", {}, "Marker"), marker);
    this.controls = [record, setMarker, capture];
    this.element.append(
      h("h2", {}, "Recording"), this.status, this.readOnly, record, this.result, setMarker,
      h("h2", {}, "Capture, with the 10 s before"), this.armed, capture,
      h("h2", {}, "Events"), this.none, this.log,
      h("h2", {}, "Flight recorder"), this.recorder.element,
    );
  }

  /** `mayEver` tells whether the server lets any page record. */
  update(device: Device, mayEver: boolean): void {
    if (this.device !== device) setText(this.result, "");
    this.device = device;
    const recording = device.state?.recording ?? null;
    setText(this.status, recording ? recordingInWords(recording) : "Not recording.");
    for (const control of this.controls) show(control, mayEver);
    show(this.readOnly, !mayEver);
    setText(this.toggle, recording ? "Stop recording" : "Start recording");
    const capture = device.state?.triggers ?? null;
    setText(this.armed, capture ? `Armed: ${triggersInWords(capture)}.` : "Not armed.");
    this.disarm.disabled = capture === null;
    this.recorder.update(device, mayEver);
    const now = `${device.info.id} ${device.events.length} ${device.events[0]?.time_ms} ${device.events[0]?.text}`;
    if (now === this.known) return;
    this.known = now;
    show(this.none, device.events.length === 0);
    this.log.replaceChildren(...device.events.map(({ time_ms, kind, text }) =>
      h("li", {}, h("time", {}, clock(time_ms)), " ", h("b", {}, words(kind)), ` ${text}`)));
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

  private async ask(type: string, content: object, patience_ms?: number): Promise<boolean> {
    if (this.device === null) return false;
    const answer = await this.requests.ask(type, this.device.info.id, content, patience_ms);
    setText(this.result, answer.ok ? answer.text || "Done." : `Refused: ${answer.text}`);
    setAttribute(this.result, "data-ok", String(answer.ok));
    return answer.ok;
  }
}

/** The running recording in words. */
export function recordingInWords({ file, samples, lost, by }: Recording): string {
  const notes = [`${count(samples)} samples`, ...(lost > 0 ? [`${count(lost)} samples lost: the disk is too slow`] : []), ...(by === null ? [] : [`started by ${by}`])];
  return `Recording to ${file}: ${notes.join(", ")}`;
}

/** The armed triggers in words. */
export function triggersInWords({ alarm, overshoot, pressure }: Triggers): string {
  const level = (name: string, value: number | null) => (value === null ? [] : [`${name} above ${plain(value)} cmH2O`]);
  return [...level("overshoot", overshoot), ...level("pressure", pressure), ...(alarm ? ["an alarm"] : [])].join(", ");
}
