// The panel for steering a device: the settings as asked and as applied, start and stop, and who steers.

import { changes, large, typed } from "./confirm";
import type { Device } from "./device";
import { confirm } from "./dialog";
import { button, h, setAttribute, setText, show } from "./dom";
import { plain, words } from "./format";
import type { Requests } from "./requests";
import type { Answer, Setting, Values } from "./stream";

interface Row {
  setting: Setting;
  input: HTMLInputElement;
  applied: HTMLElement;
  pending: HTMLElement;
}

export class Steer {
  readonly element = h("div", { class: "steer" });
  private readonly who = h("p", { class: "who", role: "status" });
  private readonly result = h("p", { class: "result", role: "status", "aria-live": "polite" });
  private readonly body = h("tbody");
  private rows: Row[] = [];
  private device: Device | null = null;
  private readonly take = button("Take control", () => this.toggle());
  private readonly start = button("Start ventilation", () => this.startStop(), { class: "start" });
  /** Submits the form, as Enter in a field does. */
  private readonly apply = h("button", { type: "submit", class: "apply" }, "Apply");
  private readonly reset = button("Undo typing", () => this.copyApplied());

  constructor(private readonly requests: Requests, private readonly send: (message: object) => boolean) {
    const heads = ["Setting", "Asked", "Applied", "Bounds, unit"].map((text) => h("th", { scope: "col" }, text));
    const table = h("table", { class: "settings" }, h("thead", {}, h("tr", {}, ...heads)), this.body);
    const form = h("form", { onsubmit: (event) => { event.preventDefault(); this.applyAll(); }, novalidate: true }, table,
      h("div", { class: "row" }, this.apply, this.reset));
    this.element.append(h("div", { class: "row" }, this.take, this.start), this.who, this.result, form);
  }

  /** Makes the rows of the settings of the server's greeting. */
  describe(settings: readonly Setting[]): void {
    this.rows = settings.map((setting) => this.row(setting));
    this.device = null;
  }

  update(device: Device, mayEver: boolean): void {
    if (this.device !== device) {
      this.device = device;
      setText(this.result, "");
      this.copyApplied();
    }
    const may = device.yours && (device.state?.connected ?? false);
    setText(this.who, who(device, mayEver));
    show(this.take, mayEver);
    show(this.start, mayEver);
    setText(this.take, device.yours ? "Release control" : "Take control");
    setText(this.start, device.state?.ventilating ? "Stop ventilation" : "Start ventilation");
    setAttribute(this.start, "data-stops", String(device.state?.ventilating ?? false));
    for (const control of [this.start, this.apply, this.reset, ...this.rows.map(({ input }) => input)]) control.disabled = !may;
    for (const row of this.rows) this.values(row, device, may);
  }

  private row(setting: Setting): Row {
    const id = `setting-${setting.name}`;
    const input = h("input", {
      id, type: "text", inputmode: "decimal", autocomplete: "off", "aria-describedby": `${id}-bounds`,
      onkeydown: (event) => this.stepBy(event as KeyboardEvent, row), oninput: () => this.mark(row),
    });
    const [applied, pending] = [h("span", { class: "applied" }), h("span", { class: "pending" })];
    const row: Row = { setting, input, applied, pending };
    const bounds = h("td", { class: "bounds", id: `${id}-bounds` }, `${plain(setting.min)} to ${plain(setting.max)} ${setting.unit}`);
    const label = h("label", { for: id, title: setting.description }, words(setting.name));
    this.body.append(h("tr", {}, h("th", { scope: "row" }, label), h("td", {}, input), h("td", {}, applied, pending), bounds));
    return row;
  }

  private values(row: Row, { state }: Device, may: boolean): void {
    const { name } = row.setting;
    const [now, next] = [state?.settings[name], state?.pending?.[name]];
    setText(row.applied, now === undefined ? "--" : plain(now));
    setText(row.pending, next === undefined || (now !== undefined && plain(next) === plain(now)) ? "" : ` → ${plain(next)}`);
    // A viewer sees the applied values in both columns.
    if (!may && now !== undefined) row.input.value = plain(now);
    this.mark(row);
  }

  private mark({ setting, input, applied }: Row): void {
    const value = typed(setting, input.value);
    const wrong = "reason" in value;
    setAttribute(input, "aria-invalid", wrong && input.value !== "" ? "true" : null);
    setAttribute(input, "data-changed", String(!wrong && plain(value.value) !== applied.textContent));
  }

  /** Arrow keys change a value by a hundredth of its range, rounded to a handy step. */
  private stepBy(event: KeyboardEvent, row: Row): void {
    const direction = event.key === "ArrowUp" ? 1 : event.key === "ArrowDown" ? -1 : 0;
    const now = typed(row.setting, row.input.value);
    if (direction === 0 || "reason" in now) return;
    event.preventDefault();
    const { min, max } = row.setting;
    const step = max - min > 20 ? 1 : max - min > 5 ? 0.1 : 0.05;
    row.input.value = plain(Math.min(Math.max(now.value + direction * step, min), max));
    this.mark(row);
  }

  private copyApplied(): void {
    for (const row of this.rows) {
      const value = this.device?.state?.settings[row.setting.name];
      row.input.value = value === undefined ? "" : plain(value);
      this.mark(row);
    }
  }

  private toggle(): void {
    const { device } = this;
    if (device === null) return;
    if (!this.send({ type: device.yours ? "release" : "take", device: device.info.id })) setText(this.result, "No connection: nothing was sent.");
    if (!device.yours) this.copyApplied();
  }

  private async startStop(): Promise<void> {
    const { device } = this;
    if (device === null) return;
    if (device.state?.ventilating) await this.stopIt(device);
    else await this.startIt(device);
  }

  private async stopIt({ info }: Device): Promise<void> {
    if (!(await confirm("Stop ventilation?", [`${info.name} will stop ventilating.`], "Stop ventilation"))) return;
    this.report(await this.requests.ask("stop", info.id));
  }

  /** A device starts only with settings that were sent since it went to standby: the dialog shows them, and they go first. */
  private async startIt({ info }: Device): Promise<void> {
    const asked = this.asked();
    if (asked === null) return;
    const list = this.rows.map(({ setting: { name, unit } }) => `${words(name)} ${plain(asked[name] ?? 0)} ${unit}`).join(", ");
    if (!(await confirm("Start ventilation?", [`${info.name} will start ventilating with these settings:`, `${list}.`], "Start ventilation"))) return;
    const applied = await this.requests.ask("apply", info.id, { settings: asked });
    this.report(applied, asked);
    if (applied.ok) this.report(await this.requests.ask("start", info.id));
  }

  /** The typed settings; null if one is wrong, which is then in focus. */
  private asked(): Values | null {
    const asked: Values = {};
    for (const { setting, input } of this.rows) {
      const value = typed(setting, input.value);
      if ("reason" in value) {
        setText(this.result, value.reason);
        input.focus();
        return null;
      }
      asked[setting.name] = value.value;
    }
    return asked;
  }

  private async applyAll(): Promise<void> {
    const { device } = this;
    const asked = this.asked();
    const applied = device?.state?.settings;
    if (device === null || asked === null || applied === undefined) return;
    const settings = this.rows.map(({ setting }) => setting);
    if (changes(settings, applied, asked).length === 0) {
      setText(this.result, "Nothing to change: the values are applied already.");
      return;
    }
    const steps = large(settings, applied, asked);
    if (steps.length > 0 && !(await confirm("Apply a large change of pressure?", steps, "Apply"))) return;
    this.report(await this.requests.ask("apply", device.info.id, { settings: asked }), asked);
  }

  /** Shows the answer; the values as applied replace the typed ones, and a difference is named. */
  private report(answer: Answer, asked?: Values): void {
    const applied = answer.settings;
    let text = answer.ok ? answer.text || "Accepted." : `Refused: ${answer.text}`;
    setAttribute(this.result, "data-ok", String(answer.ok));
    if (answer.ok && applied !== null && asked !== undefined) {
      const settings = this.rows.map(({ setting }) => setting);
      const differing = changes(settings, asked, applied).map(({ name }) => `${words(name)} ${plain(applied[name] ?? Number.NaN)}`);
      if (differing.length > 0) text += ` Applied instead: ${differing.join(", ")}.`;
      for (const { setting, input } of this.rows) input.value = plain(applied[setting.name] ?? asked[setting.name] ?? 0);
    }
    setText(this.result, text);
  }
}

function who(device: Device, mayEver: boolean): string {
  const holder = device.state?.steered_by ?? null;
  if (device.yours) return "This page steers the device.";
  const steers = holder === null ? "No one steers the device." : `${holder} steers the device.`;
  return mayEver ? steers : `${steers} This page is read-only: start the server with --steer to change settings.`;
}
