// Sounds the alarm tones by Web Audio.
//
// A browser allows sound only after a click or a key; until then `blocked` is true and the page says so. A burst in progress is
// never cut by one of lower priority.

import type { Priority } from "./stream";
import { HARMONICS, PATTERNS, pulses, repeat, urgency } from "./tones";

/** Time of a pulse's rise and fall, s. */
const EDGE = 0.02;
const VOLUME = 0.25;

export class Sound {
  private context: AudioContext | null = null;
  private output: GainNode | null = null;
  private playing: Priority | null = null;
  private next = 0;
  /** Bursts sounded so far. */
  bursts = 0;

  /** Whether the browser does not allow sound yet. */
  get blocked(): boolean {
    return this.context?.state !== "running";
  }

  /** Asks for sound; call it on a click or key. */
  unlock(): void {
    if (this.context === null) {
      this.context = new AudioContext();
      this.output = this.context.createGain();
      this.output.connect(this.context.destination);
    }
    if (this.context.state !== "running") this.context.resume().catch(() => {});
  }

  /** Sounds for the most urgent alarm; null is silence. Call it several times a second. */
  update(priority: Priority | null): void {
    const { context } = this;
    if (context === null || this.blocked) return;
    if (priority === null) {
      this.silence();
    } else if (context.currentTime >= this.next || urgency(priority) > urgency(this.playing)) {
      this.silence();
      this.burst(context, priority);
    }
  }

  /** Ends a burst at once. */
  private silence(): void {
    if (this.playing === null || this.context === null) return;
    this.output?.disconnect();
    this.output = this.context.createGain();
    this.output.connect(this.context.destination);
    this.playing = null;
    this.next = 0;
  }

  private burst(context: AudioContext, priority: Priority): void {
    const begin = context.currentTime + 0.02;
    for (const start of pulses(priority)) this.pulse(context, priority, begin + start);
    this.playing = priority;
    this.next = begin + repeat(priority);
    this.bursts += 1;
  }

  private pulse(context: AudioContext, priority: Priority, start: number): void {
    const { pulse, pitch } = PATTERNS[priority];
    const wave = context.createPeriodicWave(new Float32Array(HARMONICS.length + 1), new Float32Array([0, ...HARMONICS]));
    const tone = new OscillatorNode(context, { type: "custom", periodicWave: wave, frequency: pitch });
    const gain = context.createGain();
    gain.gain.setValueAtTime(0, start);
    gain.gain.linearRampToValueAtTime(VOLUME, start + EDGE);
    gain.gain.setValueAtTime(VOLUME, start + pulse - EDGE);
    gain.gain.linearRampToValueAtTime(0, start + pulse);
    tone.connect(gain).connect(this.output ?? context.destination);
    tone.start(start);
    tone.stop(start + pulse);
  }
}
