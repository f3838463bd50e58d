// Requests to the server: each has a number, and its answer comes back under it or is given up.

import type { Answer } from "./stream";

/** Requests are given up after this time, ms: the server asks a device four times, 1.5 s each, before it answers. */
export const PATIENCE_MS = 8_000;

export class Requests {
  private next = 1;
  private readonly waiting = new Map<number, (answer: Answer) => void>();

  constructor(private readonly send: (message: object) => boolean) {}

  /** Sends a request for a device and waits for the answer; it never fails, a missing answer is a refusal after `patience_ms`. */
  ask(type: string, device: number, content: object = {}, patience_ms = PATIENCE_MS): Promise<Answer> {
    const id = this.next++;
    const refusal = (text: string): Answer => ({ type: "answer", id, ok: false, text, settings: null });
    if (!this.send({ type, id, device, ...content })) return Promise.resolve(refusal("No connection: nothing was sent."));
    return new Promise((resolve) => {
      const patience = setTimeout(() => this.take(refusal("The server has not answered. Check the values before you ask again.")), patience_ms);
      this.waiting.set(id, (answer) => {
        clearTimeout(patience);
        resolve(answer);
      });
    });
  }

  take(answer: Answer): void {
    this.waiting.get(answer.id)?.(answer);
    this.waiting.delete(answer.id);
  }

  /** Refuses everything that waits, because the connection broke. */
  abandon(): void {
    for (const id of [...this.waiting.keys()]) {
      this.take({ type: "answer", id, ok: false, text: "The connection broke before the answer came.", settings: null });
    }
  }
}
