// The page's own audio pause, by the rules of the device's sounder (shared/src/device/annunciator.rs). Pure.

import type { Priority } from "./stream";
import { urgency } from "./tones";

/** An alarm without an acknowledgement: `key` names its device and the alarm. */
export interface Unacknowledged {
  key: string;
  priority: Priority;
}

export class Pause {
  private until = 0;
  private known: readonly Unacknowledged[] = [];

  /** Begins at a time in ms, for some seconds. */
  begin(now: number, seconds: number): void {
    this.until = now + 1000 * seconds;
  }

  end(): void {
    this.until = 0;
  }

  /**
   * Takes the unacknowledged alarms of all devices and returns the rest of the pause, s. A new alarm ends it if its priority is high, or
   * higher than that of all paused alarms; so does the end of the last alarm.
   */
  step(now: number, alarms: readonly Unacknowledged[]): number {
    const paused = new Map(this.known.map(({ key, priority }) => [key, urgency(priority)]));
    const most = Math.max(0, ...paused.values());
    const ends = alarms.some(({ key, priority }) => {
      const own = urgency(priority);
      return own > (paused.get(key) ?? 0) && (priority === "high" || own > most);
    });
    if (ends || alarms.length === 0) this.end();
    this.known = alarms;
    return Math.max(0, (this.until - now) / 1000);
  }
}
