// The demo's buttons: each makes something go wrong with the lung that is shown, or mends it.

import type { Device } from "./device";
import { button, h, setText } from "./dom";
import type { Requests } from "./requests";

const FAULTS: [string, string][] = [["disconnect", "Disconnect"], ["cough", "Cough"], ["stick", "Stick the sensor"], ["none", "Mend all"]];

export class Demo {
  readonly element = h("div", { class: "demo", role: "group", "aria-label": "Demo: faults" });
  private readonly result = h("span", { class: "spoken", role: "status" });
  private device: Device | null = null;

  constructor(private readonly requests: Requests) {
    this.element.append(h("span", { class: "demo-name" }, "Demo"));
    for (const [fault, text] of FAULTS) this.element.append(button(text, () => this.fault(fault), { "data-fault": fault }));
    this.element.append(this.result);
  }

  update(device: Device): void {
    this.device = device;
  }

  private async fault(fault: string): Promise<void> {
    if (this.device === null) return;
    const answer = await this.requests.ask("fault", this.device.info.id, { fault });
    setText(this.result, answer.text || (answer.ok ? "Done." : "Refused."));
  }
}
