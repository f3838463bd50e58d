// The audio control: the sound of all devices, its pause, and whether the browser allows sound at all.
//
// A page that steers a device pauses that device's sounder, and the page's sound of it follows. All other sounds are paused by the
// page alone.

import { sounding, unacknowledged } from "./alarms";
import type { Device } from "./device";
import { button, h, setText, show } from "./dom";
import { Pause } from "./pause";
import type { Requests } from "./requests";
import { Sound } from "./sound";
import type { Alarm, Priority } from "./stream";
import { urgency } from "./tones";

/** Time for which a refusal is shown, ms. */
const REFUSAL_MS = 8_000;

export class Audio {
  readonly element = h("div", { class: "audio", role: "group", "aria-label": "Alarm sound" });
  private readonly sound = new Sound();
  private readonly state = h("span", { class: "audio-state", role: "status" });
  private readonly pauseButton = button("Pause", () => this.toggle(), { class: "pause" });
  private readonly unlockButton = button("Sound on", () => this.sound.unlock(), { class: "unlock" });
  private readonly pause = new Pause();
  private devices: readonly Device[] = [];
  /** Rest of the pause that this page can end, s. */
  private left = 0;
  private refusal = { text: "", until: 0 };
  /** Longest pause, s. */
  longest = 0;

  constructor(private readonly requests: Requests) {
    this.element.append(this.state, this.unlockButton, this.pauseButton);
    for (const kind of ["pointerdown", "keydown"]) document.addEventListener(kind, () => this.sound.unlock());
  }

  /** Sounds for the most urgent alarm of all devices and of the page. Call it several times a second. */
  update(now: number, devices: readonly Device[], shown: Device | null, page: readonly Alarm[]): void {
    this.devices = devices;
    const own = this.pause.step(now, [...unacknowledged("page", page), ...devices.flatMap((device) => unacknowledged(device.info.id, device.alarms()))]);
    const priorities = devices.map((device) => {
      if (own <= 0) return sounding(device.state, device.own());
      return device.yours ? sounding(device.state, []) : null;
    });
    if (own <= 0) priorities.push(sounding(null, page));
    const priority = priorities.reduce((worst, one) => (urgency(one) > urgency(worst) ? one : worst), null);
    this.sound.update(priority);
    this.left = Math.max(own, ...devices.filter(({ yours }) => yours).map(rest));
    this.describe(now, priority, Math.max(this.left, shown ? rest(shown) : 0));
  }

  private describe(now: number, priority: Priority | null, left: number): void {
    const { blocked } = this.sound;
    show(this.unlockButton, blocked);
    const sound = blocked ? "Sound is off" : priority ? `Sounding: ${priority} priority` : "No sound";
    const paused = left > 0 ? `Paused, ${Math.ceil(left)} s left` : "";
    // A browser without sound is told even during a pause, and so is an alarm that sounds in spite of it.
    const both = paused !== "" && (blocked || priority !== null) ? `${sound}. ${paused}` : paused || sound;
    setText(this.state, now < this.refusal.until ? this.refusal.text : both);
    setText(this.pauseButton, this.left > 0 ? "End pause" : `Pause ${this.longest} s`);
    this.element.dataset.bursts = String(this.sound.bursts);
    this.element.dataset.paused = String(left > 0);
  }

  /** Pauses the sound, or ends the pause. */
  async toggle(): Promise<void> {
    const seconds = this.left > 0 ? 0 : this.longest;
    if (seconds > 0) this.pause.begin(performance.now(), seconds);
    else this.pause.end();
    const steered = this.devices.filter(({ yours }) => yours);
    const answers = await Promise.all(steered.map(({ info }) => this.requests.ask("pause_audio", info.id, { seconds })));
    const refused = answers.find(({ ok }) => !ok);
    if (refused) this.refusal = { text: `Pause refused: ${refused.text}`, until: performance.now() + REFUSAL_MS };
  }
}

/** Rest of the pause of a device's sounder, s. */
function rest({ state }: Device): number {
  return state?.audio.pause_left ?? 0;
}
