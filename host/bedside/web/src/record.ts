// The panel for recordings, markers and triggered captures, and the log of what happened.

import { clock } from "./alarms";
import type { Device } from "./device";
import { button, h, setText, show } from "./dom";
import { count, words } from "./format";
import type { Requests } from "./requests";

export class Record {
  readonly element = h("div", { class: "record" });
  private readonly status = h("p", { role: "status" });
  private readonly result = h("p", { class: "result", role: "status", "aria-live": "polite" });
  private readonly log = h("ol", { class: "log", "aria-label": "Events, the newest first" });
  private readonly none = h("p", { class: "quiet" }, "No events yet.");
  private readonly toggle = button("Start recording", () => this.record());
  private readonly text = h("input", { id: "marker-text", type: "text", maxlength: "200", placeholder: "for example: lung changed" });
  private readonly overshoot = h("input", { id: "capture-overshoot", type: "text", inputmode: "decimal", placeholder: "off" });
  private readonly pressure = h("input", { id: "capture-pressure", type: "text", inputmode: "decimal", placeholder: "off" });
  private readonly alarm = h("input", { id: "capture-alarm", type: "checkbox", checked: true });
  private device: Device | null = null;
  private known = "";

  constructor(private readonly requests: Requests) {
    const field = (label: string, input: HTMLElement, unit = "") => h("label", { class: "field" }, h("span", {}, label), input, unit);
    const marker = h("form", { class: "row", onsubmit: (event) => { event.preventDefault(); this.mark(); } },
      field("Text", this.text), h("button", { type: "submit" }, "Set marker"));
    const capture = h("form", { onsubmit: (event) => { event.preventDefault(); this.capture(); } },
      field("On overshoot above", this.overshoot, "cmH2O"), field("On pressure above", this.pressure, "cmH2O"), field("On an alarm", this.alarm),
      h("div", { class: "row" }, h("button", { type: "submit" }, "Arm capture")));
    this.element.append(
      h("h2", {}, "Recording"), this.status, h("div", { class: "row" }, this.toggle), this.result,
      h("h2", {}, "Marker"), marker,
      h("h2", {}, "Capture, with the 10 s before"), capture,
      h("h2", {}, "Events"), this.none, this.log,
    );
  }

  update(device: Device): void {
    if (this.device !== device) setText(this.result, "");
    this.device = device;
    const recording = device.state?.recording ?? null;
    setText(this.status, recording ? `Recording to ${recording.file}: ${count(recording.samples)} samples` : "Not recording.");
    setText(this.toggle, recording ? "Stop recording" : "Start recording");
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
    const level = (input: HTMLInputElement) => {
      const value = Number(input.value.replace(",", "."));
      return input.value.trim() === "" || !(value > 0) ? null : value;
    };
    await this.ask("capture", { triggers: { overshoot: level(this.overshoot), pressure: level(this.pressure), alarm: this.alarm.checked } });
  }

  private async ask(type: string, content: object): Promise<boolean> {
    if (this.device === null) return false;
    const answer = await this.requests.ask(type, this.device.info.id, content);
    setText(this.result, answer.ok ? answer.text || "Done." : `Refused: ${answer.text}`);
    return answer.ok;
  }
}
