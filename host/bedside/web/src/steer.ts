// The panel for steering a device: the settings as asked and as applied, start and stop, and who steers.

import { changes, large, steerers, typed } from "./confirm";
import type { Device } from "./device";
import { confirm } from "./dialog";
import { button, h, setAttribute, setText, show } from "./dom";
import { plain, sentence, UNKNOWN, words } from "./format";
import type { Requests } from "./requests";
import type { Answer, Setting, Values } from "./stream";

interface Row {
  setting: Setting;
  input: HTMLInputElement;
  applied: HTMLElement;
  pending: HTMLElement;
  /** Whether its value was typed and is not applied yet; otherwise it follows the device. */
  edited: boolean;
}

export class Steer {
  readonly element = h("div", { class: "steer" });
  private readonly who = h("p", { class: "who", role: "status" });
  private readonly result = h("p", { class: "result", role: "status", "aria-live": "polite" });
  private readonly body = h("tbody");
  private rows: Row[] = [];
  private device: Device | null = null;
  /** A change of a pressure by more than this needs a confirmation, cmH2O. */
  private largeChange = 0;
  /** The device whose start is under way: it can take some seconds, and then it can be cancelled. */
  private starting: Device | null = null;
  private readonly take = button("Take control", () => this.toggle());
  private readonly start = button("Start ventilation", () => this.startStop(), { class: "start" });
  /** Submits the form, as Enter in a field does. */
  private readonly apply = h("button", { type: "submit", class: "apply" }, "Apply");
  private readonly reset = button("Undo typing", () => this.undo());

  constructor(private readonly requests: Requests, private readonly send: (message: object) => boolean) {
    const heads = ["Setting", "Asked", "Applied", "Bounds, unit"].map((text) => h("th", { scope: "col" }, text));
    const table = h("table", { class: "settings" }, h("thead", {}, h("tr", {}, ...heads)), this.body);
    const form = h("form", { onsubmit: (event) => { event.preventDefault(); this.applyEdited(); }, novalidate: true }, table,
      h("div", { class: "row" }, this.apply, this.reset));
    this.element.append(h("div", { class: "row" }, this.take, this.start), this.who, this.result, form);
  }

  /** Makes the rows of the settings of the server's greeting. */
  describe(settings: readonly Setting[], largeChange: number): void {
    this.body.replaceChildren();
    this.rows = settings.map((setting) => this.row(setting));
    this.largeChange = largeChange;
    this.device = null;
  }

  update(device: Device, mayEver: boolean): void {
    if (this.device !== device) {
      this.device = device;
      setText(this.result, "");
      this.undo();
    }
    const may = device.yours && device.state?.connected === true && this.rows.every(({ setting }) => device.state?.settings[setting.name] !== undefined);
    if (!may) this.undo();
    setText(this.who, who(device, mayEver));
    show(this.take, mayEver);
    show(this.start, mayEver);
    setText(this.take, device.yours ? "Release control" : steerers(device.state).length > 0 ? "Take over control" : "Take control");
    const [starts, ventilates] = [this.starting === device, device.state?.ventilating ?? false];
    setText(this.start, ventilates ? "Stop ventilation" : starts ? "Cancel the start" : "Start ventilation");
    setAttribute(this.start, "data-stops", String(ventilates || starts));
    // To stop, the settings need not be known; a device that cannot be reached is the server's to tell.
    this.start.disabled = ventilates || starts ? !device.yours : !may;
    for (const control of [this.apply, this.reset, ...this.rows.map(({ input }) => input)]) control.disabled = !may;
    for (const row of this.rows) this.values(row, device);
  }

  private row(setting: Setting): Row {
    const id = `setting-${setting.name}`;
    const input = h("input", {
      id, type: "text", inputmode: "decimal", autocomplete: "off", "aria-describedby": `${id}-bounds`,
      onkeydown: (event) => this.stepBy(event as KeyboardEvent, row), oninput: () => this.edit(row),
    });
    const [applied, pending] = [h("span", { class: "applied" }), h("span", { class: "pending" })];
    const row: Row = { setting, input, applied, pending, edited: false };
    const bounds = h("td", { class: "bounds", id: `${id}-bounds` }, `${plain(setting.min)} to ${plain(setting.max)} ${setting.unit}`);
    const label = h("label", { for: id, title: setting.description }, words(setting.name));
    this.body.append(h("tr", {}, h("th", { scope: "row" }, label), h("td", {}, input), h("td", {}, applied, pending), bounds));
    return row;
  }

  private edit(row: Row): void {
    row.edited = true;
    this.mark(row);
  }

  private values(row: Row, { state }: Device): void {
    const { name } = row.setting;
    const [now, next] = [state?.settings[name], state?.pending?.[name]];
    setText(row.applied, now === undefined ? UNKNOWN : plain(now));
    setText(row.pending, next === undefined || (now !== undefined && plain(next) === plain(now)) ? "" : ` → ${plain(next)}`);
    if (!row.edited) this.follow(row);
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
    this.edit(row);
  }

  /** Writes the value that applies next into a field. */
  private follow({ setting: { name }, input }: Row): void {
    const state = this.device?.state;
    const value = state?.pending?.[name] ?? state?.settings[name];
    const text = value === undefined ? "" : plain(value);
    // Setting an equal value would move the caret.
    if (input.value !== text) input.value = text;
  }

  /** Forgets the typed values. */
  private undo(): void {
    for (const row of this.rows) {
      row.edited = false;
      this.follow(row);
      this.mark(row);
    }
  }

  private async toggle(): Promise<void> {
    const { device } = this;
    if (device === null) return;
    const [id, others] = [device.info.id, steerers(device.state)];
    if (device.yours) return this.tell({ type: "release", device: id });
    if (others.length === 0) return this.tell({ type: "take", device: id });
    const lines = others.map((who) => `${who} steers ${device.info.name} now and will lose control.`);
    if (await confirm("Take over control?", lines, "Take over")) this.tell({ type: "take", device: id, take_over: true });
  }

  private tell(message: object): void {
    setText(this.result, this.send(message) ? "" : "No connection: nothing was sent.");
  }

  private async startStop(): Promise<void> {
    const { device } = this;
    if (device === null) return;
    if (device.state?.ventilating) await this.stopIt(device);
    else if (this.starting === device) await this.cancel(device);
    else await this.startIt(device);
  }

  private async stopIt(device: Device): Promise<void> {
    if (!(await confirm("Stop ventilation?", [`${device.info.name} will stop ventilating.`], "Stop ventilation"))) return;
    this.report(device, await this.requests.ask("stop", device.info.id));
  }

  /** Stops a device that has not started yet. */
  private async cancel(device: Device): Promise<void> {
    this.starting = null;
    this.report(device, await this.requests.ask("stop", device.info.id));
  }

  /** A device starts only with settings that were sent since it went to standby: the dialog shows them, and they go first. */
  private async startIt(device: Device): Promise<void> {
    const { info } = device;
    const asked = this.asked(this.rows);
    if (asked === null) return;
    const list = this.rows.map(({ setting: { name, unit } }) => `${words(name)} ${plain(asked[name] ?? 0)} ${unit}`).join(", ");
    if (!(await confirm("Start ventilation?", [`${info.name} will start ventilating with these settings:`, `${list}.`], "Start ventilation"))) return;
    this.starting = device;
    const applied = await this.requests.ask("apply", info.id, { settings: asked });
    this.report(device, applied, asked);
    // It may be cancelled meanwhile.
    const started = applied.ok && this.starting === device ? await this.requests.ask("start", info.id) : null;
    if (this.starting !== device) return;
    this.starting = null;
    if (started !== null) this.report(device, started);
  }

  /** The settings in these rows; null if one is wrong, which is then in focus. */
  private asked(rows: readonly Row[]): Values | null {
    const asked: Values = {};
    for (const { setting, input } of rows) {
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

  /** Sends the edited settings alone, so that a change from elsewhere meanwhile stays. */
  private async applyEdited(): Promise<void> {
    const { device } = this;
    const edited = this.rows.filter((row) => row.edited);
    const asked = this.asked(edited);
    const state = device?.state;
    if (device === null || asked === null || state == null) return;
    const settings = edited.map(({ setting }) => setting);
    if (changes(settings, { ...state.settings, ...state.pending }, asked).length === 0) {
      this.undo();
      setText(this.result, "Nothing to change: the values are already in force.");
      return;
    }
    const steps = large(settings, state.settings, asked, this.largeChange);
    if (steps.length > 0 && !(await confirm("Apply a large change of pressure?", steps, "Apply"))) return;
    this.report(device, await this.requests.ask("apply", device.info.id, { settings: asked }), asked);
  }

  /** Shows the answer. Fields that still hold the sent value follow the device again, and a difference is named. */
  private report(device: Device, answer: Answer, asked?: Values): void {
    // Another device may be shown meanwhile.
    if (this.device !== device) return;
    const applied = answer.settings;
    let text = answer.ok ? sentence(answer.text || "accepted") : sentence(`refused: ${answer.text}`);
    setAttribute(this.result, "data-ok", String(answer.ok));
    if (answer.ok && applied !== null && asked !== undefined) {
      const settings = this.rows.map(({ setting }) => setting).filter(({ name }) => asked[name] !== undefined);
      const differing = changes(settings, asked, applied).map(({ name }) => `${words(name)} ${plain(applied[name] ?? Number.NaN)}`);
      if (differing.length > 0) text += ` Applied instead: ${differing.join(", ")}.`;
    }
    if (answer.ok && asked !== undefined) {
      for (const row of this.rows) {
        const value = asked[row.setting.name];
        if (value !== undefined && typedAs(row, value)) row.edited = false;
      }
    }
    setText(this.result, text);
  }
}

/** Whether a field holds a value. */
function typedAs({ setting, input }: Row, value: number): boolean {
  const now = typed(setting, input.value);
  return "value" in now && now.value === value;
}

function who(device: Device, mayEver: boolean): string {
  const [holder, lease] = [device.state?.steered_by ?? null, device.state?.lease ?? null];
  const page = device.yours ? "This page steers the device." : holder === null ? "No page steers the device." : `${holder} steers the device.`;
  // Another program may hold the device's lease, past all pages.
  const obeys = lease === null ? "" : ` ${sentence(`${lease} holds the device's lease`)}`;
  const reads = mayEver ? "" : " This page is read-only: start the server with --steer to change settings.";
  return page + obeys + reads;
}
