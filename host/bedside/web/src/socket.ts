// The connection to the server: opens it, and opens it again with growing pauses after it broke or fell silent.

import { deliver, type Listener, type Transport } from "./transport";

/** First and longest pause between two attempts, ms. */
const FIRST_MS = 250;
const LONGEST_MS = 5_000;
/** Attempts that have not succeeded after this time are given up, ms. */
const OPEN_MS = 4_000;
/**
 * A connection on which nothing has come for this time is given up, ms: the server sends several messages a second, and a browser does
 * not notice that the network or the server's computer is gone.
 */
const SILENT_MS = 5_000;
/** A longer time between two calls of `keep` means that the page was held up, ms. */
const HELD_UP_MS = 1_500;
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
  /** From when on silence counts, if nothing was heard later: the beginning of the attempt, or the end of a time without `keep`. */
  private from = 0;
  private kept = performance.now();
  readonly loading = false;
  heard = performance.now();
  malformed = 0;

  constructor(private readonly url: string, private readonly listener: Listener) {
    this.open(performance.now());
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

  /** Opens the connection again when it is due, and gives up one that is silent. */
  keep(now: number): void {
    // Messages may wait behind this call in a page that was held up or slept: they have their time, too.
    if (now - this.kept > HELD_UP_MS) this.from = now;
    this.kept = now;
    if (this.socket === null) {
      if (now >= this.nextAttempt) this.open(now);
      return;
    }
    const limit = this.connected ? SILENT_MS : OPEN_MS;
    if (now - Math.max(this.heard, this.from) > limit) this.giveUp(this.socket, now);
  }

  private open(now: number): void {
    const socket = new WebSocket(this.url);
    this.socket = socket;
    this.from = now;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.heard = performance.now();
      this.since = this.heard;
      this.listener.opened();
    };
    socket.onmessage = ({ data }) => this.receive(data);
    socket.onclose = ({ reason, code }) => {
      const refused = code === BROKEN_RULE && performance.now() - this.since < SOON_MS;
      if (this.socket === socket) this.retry(reason, refused, performance.now());
    };
  }

  /** Leaves a connection without waiting for its end: the other side may be gone, and then no answer to the closing comes. */
  private giveUp(socket: WebSocket, now: number): void {
    for (const listener of ["onopen", "onmessage", "onclose"] as const) socket[listener] = null;
    socket.close();
    this.retry("", false, now);
  }

  private receive(data: string | ArrayBuffer): void {
    this.heard = performance.now();
    this.attempts = 0;
    if (!deliver(data, this.listener)) this.malformed += 1;
  }

  private retry(reason: string, refused: boolean, now: number): void {
    this.socket = null;
    const wait = pause(this.attempts, Math.random());
    this.attempts = Math.min(this.attempts + 1, 10);
    this.nextAttempt = now + wait;
    this.listener.closed(reason, refused);
  }
}
