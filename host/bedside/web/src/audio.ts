// The audio control: what sounds, the pause of at most 120 s, and whether the browser allows sound at all.
//
// A page that steers pauses the device's sounder, and its own sound follows. Any other page can pause only its own sound.

import { sounding } from "./alarms";
import type { Device } from "./device";
import { button, h, setText, show } from "./dom";
import type { Requests } from "./requests";
import { Sound } from "./sound";
import type { Priority } from "./stream";
import { AUDIO_PAUSE_MAX, urgency } from "./tones";

export class Audio {
  readonly element = h("div", { class: "audio", role: "group", "aria-label": "Alarm sound" });
  private readonly sound = new Sound();
  private readonly state = h("span", { class: "audio-state" });
  private readonly pauseButton = button("Pause", () => this.pause(), { class: "pause" });
  private readonly unlockButton = button("Sound on", () => this.sound.unlock(), { class: "unlock" });
  private device: Device | null = null;
  /** End of the page's own pause, by performance.now(), and the most urgent priority that was paused. */
  private pausedUntil = 0;
  private paused: Priority | null = null;

  constructor(private readonly requests: Requests) {
    this.element.append(this.state, this.unlockButton, this.pauseButton);
    for (const kind of ["pointerdown", "keydown"]) document.addEventListener(kind, () => this.sound.unlock());
  }

  /** Sounds for the most urgent alarm of the shown devices. Call it several times a second. */
  update(now: number, devices: readonly Device[], shown: Device | null): void {
    this.device = shown;
    const priorities = devices.map((device) => sounding(device.state, device.own()));
    const priority = priorities.reduce((worst, one) => (urgency(one) > urgency(worst) ? one : worst), null);
    // A more urgent alarm ends the pause.
    if (urgency(priority) > urgency(this.paused)) this.pausedUntil = 0;
    const own = Math.max(0, (this.pausedUntil - now) / 1000);
    this.sound.update(own > 0 ? null : priority);
    this.describe(priority, Math.max(own, shown?.state?.audio.pause_left ?? 0));
  }

  private describe(priority: Priority | null, left: number): void {
    show(this.unlockButton, this.sound.blocked);
    const blocked = this.sound.blocked ? "Sound is off" : "";
    const text = left > 0 ? `Paused, ${Math.ceil(left)} s left` : blocked || (priority ? `Sounds: ${priority}` : "No sound");
    setText(this.state, text);
    setText(this.pauseButton, left > 0 ? "End pause" : `Pause ${AUDIO_PAUSE_MAX} s`);
    this.element.dataset.bursts = String(this.sound.bursts);
    this.element.dataset.paused = String(left > 0);
  }

  /** Pauses the sound, or ends the pause. */
  async pause(): Promise<void> {
    const { device } = this;
    const now = performance.now();
    const pausing = !(this.pausedUntil > now) && !((device?.state?.audio.pause_left ?? 0) > 0);
    this.pausedUntil = pausing ? now + AUDIO_PAUSE_MAX * 1000 : 0;
    this.paused = pausing && device ? sounding(device.state, device.own()) : null;
    if (device?.yours) await this.requests.ask("pause_audio", device.info.id, { seconds: pausing ? AUDIO_PAUSE_MAX : 0 });
  }
}
