// The connection to the server: opens it, and opens it again with growing pauses after it broke.

import { deliver, type Listener, type Transport } from "./transport";

/** First and longest pause between two attempts, ms. */
const FIRST_MS = 250;
const LONGEST_MS = 5_000;
/** Attempts that have not succeeded after this time are given up, ms. */
const OPEN_MS = 4_000;
/** Close code of a page that broke a rule, and how soon after the opening that means its first message. */
const BROKEN_RULE = 1008;
const SOON_MS = 3_000;

/** Pause before attempt `number` (from 0), ms; `chance` from 0 to 1 spreads the attempts of many pages. */
export function pause(number: number, chance: number): number {
  return Math.min(FIRST_MS * 2 ** number, LONGEST_MS) * (0.8 + 0.4 * chance);
}

export class Socket implements Transport {
  private socket: WebSocket | null = null;
  private attempts = 0;
  private nextAttempt = 0;
  private since = 0;
  readonly loading = false;
  heard = performance.now();
  malformed = 0;

  constructor(private readonly url: string, private readonly listener: Listener) {
    this.open();
  }

  get connected(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  get waits(): number {
    return Math.max(0, (this.nextAttempt - performance.now()) / 1000);
  }

  send(message: object): boolean {
    if (!this.connected || this.socket === null) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  private open(): void {
    const socket = new WebSocket(this.url);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    const giveUp = setTimeout(() => socket.close(), OPEN_MS);
    socket.onopen = () => {
      clearTimeout(giveUp);
      this.heard = performance.now();
      this.since = this.heard;
      this.listener.opened();
    };
    socket.onmessage = ({ data }) => this.receive(data);
    socket.onclose = ({ reason, code }) => {
      clearTimeout(giveUp);
      const refused = code === BROKEN_RULE && performance.now() - this.since < SOON_MS;
      if (this.socket === socket) this.retry(reason, refused);
    };
  }

  private receive(data: string | ArrayBuffer): void {
    this.heard = performance.now();
    this.attempts = 0;
    if (!deliver(data, this.listener)) this.malformed += 1;
  }

  private retry(reason: string, refused: boolean): void {
    this.socket = null;
    const wait = pause(this.attempts, Math.random());
    this.attempts = Math.min(this.attempts + 1, 10);
    this.nextAttempt = performance.now() + wait;
    this.listener.closed(reason, refused);
    setTimeout(() => this.open(), wait);
  }
}
