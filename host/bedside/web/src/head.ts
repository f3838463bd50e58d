// The page's head: which device is shown, its state, the alarm banner, the sound, and the connection.

import { clock, inSafeState, worst } from "./alarms";
import { Banner, without } from "./alarm_view";
import type { Device } from "./device";
import { button, h, setAttribute, setText, show } from "./dom";
import { words } from "./format";
import type { Alarm } from "./stream";

export interface Actions {
  wall(): void;
  choose(device: Device): void;
  acknowledge(): void;
}

export class Head {
  readonly element: HTMLElement;
  readonly banner = new Banner();
  private readonly wall: HTMLButtonElement;
  private readonly select = h("select", { id: "device", "aria-label": "Device" });
  private readonly mode = h("span", { class: "mode" });
  private readonly acknowledge: HTMLButtonElement;
  private readonly connection = h("span", { class: "connection", role: "status" });
  private readonly time = h("time", { class: "clock" });
  private devices: Device[] = [];

  constructor(actions: Actions, audio: HTMLElement) {
    this.wall = button("Wall", () => actions.wall(), { class: "to-wall" });
    this.acknowledge = button("Acknowledge", () => actions.acknowledge(), { class: "acknowledge" });
    this.select.addEventListener("change", () => {
      const device = this.devices[this.select.selectedIndex];
      if (device) actions.choose(device);
    });
    this.element = h("header", { class: "head" },
      h("div", { class: "head-left" }, h("h1", {}, "Eupnea"), this.wall, this.select, this.mode),
      this.banner.element,
      h("div", { class: "head-right" }, this.acknowledge, audio, h("div", { class: "status" }, this.connection, this.time)));
  }

  describe(devices: Device[]): void {
    this.devices = devices;
    this.select.replaceChildren(...devices.map(({ info }) => h("option", { value: String(info.id) }, info.name)));
    show(this.wall, devices.length > 1);
  }

  /** Shows a device, or the wall if it is null, and the page's alarms of no device. */
  update(device: Device | null, own: readonly Alarm[]): void {
    show(this.select, device !== null);
    show(this.mode, device !== null);
    show(this.acknowledge, device !== null);
    setAttribute(this.wall, "aria-pressed", String(device === null));
    if (device) {
      this.select.selectedIndex = this.devices.indexOf(device);
      const { state } = device;
      setText(this.mode, state ? `${words(state.mode)} · ${device.info.kind}` : "waiting for the device");
      setText(this.acknowledge, inSafeState(state) ? "Acknowledge, leave safe state" : "Acknowledge");
      this.banner.update(device.alarms(), without([device]));
    } else {
      const rated = this.devices.flatMap((one) => one.alarms().map((alarm) => ({ ...alarm, text: `${one.info.name}: ${alarm.text}` })));
      this.banner.update([...own, ...rated], without(this.devices));
    }
    this.others(device);
    setText(this.time, clock(Date.now()));
  }

  /** Whether the device's alarms can be acknowledged here. */
  may(acknowledge: boolean): void {
    if (this.acknowledge.disabled === !acknowledge) return;
    this.acknowledge.disabled = !acknowledge;
    this.acknowledge.title = acknowledge ? "" : "Only the page that steers the device acknowledges its alarms.";
  }

  connect(text: string, ok: boolean): void {
    setText(this.connection, text);
    setAttribute(this.connection, "data-ok", String(ok));
  }

  /** Tells on the button of the wall that another device has an alarm. */
  private others(device: Device | null): void {
    const others = this.devices.filter((one) => one !== device && one.alarms().length > 0);
    const alarm = device === null ? null : worst(others.flatMap((one) => one.alarms()));
    setAttribute(this.wall, "data-priority", alarm?.priority ?? "none");
    setText(this.wall, alarm ? `Wall: ${others.length} with alarms` : "Wall");
  }
}
