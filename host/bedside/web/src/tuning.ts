// The panel for the margins of a device: starts and stops their measurement on a test lung, and shows its progress and its result.

import type { Device } from "./device";
import { confirm } from "./dialog";
import { button, h, setAttribute, setText, show } from "./dom";
import { plain, sentence } from "./format";
import { MarginsView } from "./margins_view";
import type { Requests } from "./requests";
import type { Choice, Measure, Measuring } from "./stream";

/** A number to choose: its field, and its bounds. */
interface Field { name: string; input: HTMLInputElement; whole: boolean; choice: Choice }

/** Names of the sines' numbers, as the server knows them. */
const NAMES = ["amplitude", "frequencies", "breaths"] as const;
const LABELS = { amplitude: ["Amplitude", "%"], frequencies: ["Frequencies", ""], breaths: ["Breaths at each", ""] } as const;

export class Tuning {
  readonly element = h("div", { class: "tuning" });
  private readonly status = h("p", { role: "status" });
  private readonly bar = h("progress", { "aria-label": "Progress of the measurement" });
  private readonly result = h("p", { class: "result", role: "status", "aria-live": "polite" });
  private readonly start = h("button", { type: "submit" }, "Measure margins");
  private readonly stop = button("Stop measuring", () => void this.end());
  private readonly why = h("p", { class: "quiet" });
  private readonly form: HTMLElement;
  private readonly fields: Field[];
  private readonly view = new MarginsView();
  private device: Device | null = null;
  private measure: Measure | null = null;
  /** Whether a measurement ran at the last update. */
  private runs = false;

  constructor(private readonly requests: Requests) {
    this.fields = NAMES.map((name) => ({
      name, whole: name !== "amplitude", choice: { min: 0, max: 0, default: 0 },
      input: h("input", { id: `sines-${name}`, type: "text", inputmode: "decimal", autocomplete: "off" }),
    }));
    const rows = this.fields.map(({ name, input }) => {
      const [label, unit] = LABELS[name as keyof typeof LABELS];
      return h("label", { class: "field" }, h("span", {}, label), input, unit);
    });
    this.form = h("form", { novalidate: true, onsubmit: (event) => { event.preventDefault(); void this.begin(); } },
      ...rows, h("div", { class: "row" }, this.start, this.stop));
    this.element.append(this.status, this.bar, this.form, this.why, this.result, this.view.element);
  }

  /** Takes the bounds of the server's greeting. */
  describe(measure: Measure | null): void {
    this.measure = measure;
    if (measure === null) return;
    for (const field of this.fields) {
      field.choice = measure[field.name as keyof typeof LABELS];
      field.input.value = plain(field.choice.default);
    }
  }

  /** `mayEver` tells whether the server lets any page steer. */
  update(device: Device, mayEver: boolean): void {
    const measuring = device.state?.measuring ?? null;
    // The result tells the rest.
    if (this.device !== device || (this.runs && measuring === null)) setText(this.result, "");
    [this.device, this.runs] = [device, measuring !== null];
    setText(this.status, measuring ? progress(measuring, device) : device.margins ? "" : "The margins of this device are not measured yet.");
    show(this.status, this.status.textContent !== "");
    show(this.bar, measuring !== null);
    if (measuring) [this.bar.max, this.bar.value] = [measuring.breaths, measuring.breath];
    const why = measuring && device.yours ? null : obstacle(device, mayEver);
    show(this.form, mayEver);
    setText(this.why, why ?? "");
    show(this.why, why !== null);
    this.start.disabled = why !== null || measuring !== null;
    this.stop.disabled = measuring === null || !device.yours;
    for (const { input } of this.fields) input.disabled = this.start.disabled;
    this.view.update(device);
  }

  /** Asks whether a test lung is connected, and then measures. */
  private async begin(): Promise<void> {
    const { device, measure } = this;
    const sines = this.sines();
    if (device === null || measure === null || sines === null) return;
    const breaths = measure.warm_up + (sines.frequencies ?? 0) * (sines.breaths ?? 0);
    const agreed = await confirm("Is a test lung connected?", [
      `Never measure with a patient. ${device.info.name} will add sines of ${plain(sines.amplitude ?? 0)} % to the command of its inspiratory valve.`,
      `For ${breaths} breaths, about ${minutes(breaths, device)}, the pressure rises along a ramp of ${plain(measure.ramp_s)} s, and no effort starts a breath. Then the settings of now come back.`,
      "An alarm ends it, and so does a page that no longer steers.",
    ], "Test lung connected: measure");
    if (agreed) await this.ask(device, "measure", { test_lung: true, sines });
  }

  private async end(): Promise<void> {
    if (this.device !== null) await this.ask(this.device, "stop_measuring", {});
  }

  private async ask(device: Device, type: string, content: object): Promise<void> {
    const answer = await this.requests.ask(type, device.info.id, content);
    // Another device may be shown meanwhile.
    if (this.device === device) this.tell(sentence(answer.ok ? answer.text : `refused: ${answer.text}`), answer.ok);
  }

  private tell(text: string, ok: boolean): void {
    setText(this.result, text);
    setAttribute(this.result, "data-ok", String(ok));
  }

  /** The numbers in the fields; null if one is wrong, which is told, and its field is in focus. */
  private sines(): Record<string, number> | null {
    const asked: Record<string, number> = {};
    for (const { name, input, whole, choice: { min, max } } of this.fields) {
      const text = input.value.trim().replace(",", ".");
      const value = text === "" ? Number.NaN : Number(text);
      const wrong = !(value >= Number(plain(min)) && value <= max && (!whole || Number.isInteger(value)));
      setAttribute(input, "aria-invalid", wrong ? "true" : null);
      if (wrong) {
        this.tell(`${LABELS[name as keyof typeof LABELS][0]}: enter a ${whole ? "whole " : ""}number from ${plain(min)} to ${plain(max)}.`, false);
        input.focus();
        return null;
      }
      asked[name] = value;
    }
    return asked;
  }
}

/** Why no measurement can begin; null if one can. */
function obstacle(device: Device, mayEver: boolean): string | null {
  if (!mayEver) return "This page is read-only: start the server with --steer to measure.";
  if (!device.yours) return "To measure, take control of the device first (tab Settings).";
  if (device.state?.connected !== true) return "The device is not connected.";
  return device.state.ventilating ? null : "To measure, start the ventilation of a test lung first (tab Settings).";
}

function progress({ breath, breaths, by }: Measuring, device: Device): string {
  const left = breath < breaths ? `, about ${minutes(breaths - breath, device)} left` : "";
  return `Measuring: breath ${breath} of ${breaths}${left}${device.yours || by === null ? "" : `, for ${by}`}.`;
}

/** The time of some breaths in words. */
function minutes(breaths: number, device: Device): string {
  const rate = device.state?.settings.rate ?? 0;
  const time = rate > 0 ? breaths / rate : 0;
  if (time < 1) return `${Math.ceil(60 * time)} s`;
  return time < 1.5 ? "1 minute" : `${time.toFixed(0)} minutes`;
}
