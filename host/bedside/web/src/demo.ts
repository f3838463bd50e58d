// The demo's buttons: each makes something go wrong with the lung that is shown, or mends it.

import type { Device } from "./device";
import { button, h, setText } from "./dom";
import type { Requests } from "./requests";

const FAULTS: [string, string][] = [["disconnect", "Disconnect"], ["cough", "Cough"], ["stick", "Stick the sensor"], ["none", "Clear faults"]];

/** Longest wait until the device is taken, ms. */
const TAKE_MS = 2_000;

export class Demo {
  readonly element = h("div", { class: "demo", role: "group", "aria-label": "Demo: faults" });
  private readonly result = h("span", { class: "note", role: "status" });
  private device: Device | null = null;

  constructor(private readonly requests: Requests, private readonly send: (message: object) => boolean) {
    this.element.append(h("span", { class: "demo-name" }, "Demo"));
    for (const [fault, text] of FAULTS) this.element.append(button(text, () => this.fault(fault), { "data-fault": fault }));
    this.element.append(this.result);
  }

  update(device: Device): void {
    this.device = device;
  }

  private async fault(fault: string): Promise<void> {
    const { device } = this;
    if (device === null) return;
    if (!device.yours) await this.take(device);
    const answer = await this.requests.ask("fault", device.info.id, { fault });
    setText(this.result, answer.text || (answer.ok ? "Done." : "Refused."));
  }

  /** A server takes faults only from the page that steers the device; a visitor need not know that. */
  private async take(device: Device): Promise<void> {
    this.send({ type: "take", device: device.info.id });
    for (let waited = 0; !device.yours && waited < TAKE_MS; waited += 50) await new Promise((resolve) => setTimeout(resolve, 50));
  }
}
