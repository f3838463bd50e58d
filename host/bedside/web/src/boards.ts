// Boards at this computer, without a server: connecting one to the page, and flashing one with the file of a release.

import { confirm, inform } from "./dialog";
import { button, h, setText } from "./dom";
import type { Local } from "./local";
import type { Firmware } from "./module";
import { SerialLine } from "./serial";
import { flash } from "./usb";

const CONNECT = "Connect a board";
const NOT_RUNNING = "The page's module is not running: reload this page.";

/** An error in words. */
const reason = (error: unknown): string => (error instanceof Error ? error.message : String(error));

export class Boards {
  readonly element = h("footer", { class: "boards", role: "group", "aria-label": "Boards at this computer" });
  private readonly note = h("span", { class: "note", role: "status" });
  private readonly toggle = button(CONNECT, () => this.connect(), { class: "connect" });
  private readonly key = h("input", { id: "release-key", type: "text", autocomplete: "off", spellcheck: "false", oninput: () => this.open() });
  private readonly file = h("input", { id: "release-file", type: "file", accept: ".zip", onchange: () => this.open() });
  private readonly result = h("p", { class: "result", role: "status", "aria-live": "polite" });
  private readonly bar = h("progress", { max: "1", value: "0", "aria-label": "Flashing" });
  private readonly write = button("Flash", () => this.flash(), { class: "start" });
  private firmware: Firmware | null = null;
  private connected = false;
  private flashing = false;

  constructor(private readonly local: Local) {
    this.element.append(this.toggle, button("Flash a board", () => this.show(), { class: "flash" }), this.note);
  }

  private async connect(): Promise<void> {
    if (this.connected) return this.disconnect("");
    try {
      const line = await SerialLine.open();
      this.connected = true;
      this.local.connect(line, () => { this.connected = false; this.label("The board was unplugged. Plug it in and connect it again."); });
      this.label("");
    } catch (error) {
      this.label(reason(error));
    }
  }

  private async disconnect(text: string): Promise<void> {
    await this.local.leave();
    this.connected = false;
    this.label(text);
  }

  private label(text: string): void {
    setText(this.toggle, this.connected ? "Disconnect the board" : CONNECT);
    setText(this.note, text);
  }

  /** Shows the dialog for flashing. */
  private show(): void {
    const { module } = this.local;
    if (module === null) {
      setText(this.note, NOT_RUNNING);
      return;
    }
    if (this.key.value === "") this.key.value = module.releaseKey();
    const row = (name: string, input: HTMLInputElement) => h("label", { class: "field", for: input.id }, h("span", {}, name), input);
    inform("Flash a board",
      h("p", {}, "Connect the board by USB and hold BOOT0 high while you reset it. Only files of a release with the right signature are flashed."),
      row("Key of the release", this.key), row("File of the release", this.file), this.result, this.bar, h("div", { class: "row" }, this.write));
    this.offer();
  }

  private offer(): void {
    this.write.disabled = this.firmware === null || this.flashing;
  }

  /** Verifies the chosen file. */
  private async open(): Promise<void> {
    const file = this.file.files?.[0];
    if (file === undefined || this.flashing) return;
    this.firmware = null;
    try {
      const bytes = new Uint8Array(await file.arrayBuffer());
      if (this.local.module === null) throw new Error(NOT_RUNNING);
      this.firmware = this.local.module.openRelease(this.key.value, bytes);
      const { image, version, revision, board } = this.firmware;
      this.tell(`${image} ${version} (revision ${revision}) for ${board}: signature and files verified.`, true);
    } catch (error) {
      this.tell(`Refused: ${reason(error)}.`, false);
    }
    this.offer();
  }

  private async flash(): Promise<void> {
    const [{ firmware }, { module }] = [this, this.local];
    if (firmware === null || module === null) return;
    const lines = [`${firmware.image} ${firmware.version} will replace program and weights of the board that you choose next.`, `Go on only if it is the board ${firmware.board}, and nobody is connected to it.`];
    if (!(await confirm(`Flash ${firmware.board}?`, lines, "Flash"))) return;
    this.flashing = true;
    this.offer();
    try {
      this.tell("Flashing: leave the board connected.", true);
      await flash(module, (share) => { this.bar.value = share; });
      this.tell("Flashed and read back. Set BOOT0 low and press the board's reset button.", true);
    } catch (error) {
      this.tell(`Not flashed: ${reason(error)}.`, false);
    }
    this.flashing = false;
    this.offer();
  }

  private tell(text: string, ok: boolean): void {
    this.result.dataset.ok = String(ok);
    setText(this.result, text.replace(/\.\.$/, "."));
  }
}
