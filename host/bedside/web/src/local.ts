// The devices in the page itself: the bench and the core of the project, compiled to WebAssembly, at the pace of the page's clock.

import { every } from "./beat";
import { deliver, type Listener, type Transport } from "./transport";

/** Interval at which the devices go on, ms. */
const ADVANCE_EVERY = 20;
/** What `next` has found. */
const TEXT = 1;
const SAMPLES = 2;

/** What the module exports, as `host/webdemo/src/exports.rs` defines it; times are in ms since 1970. */
export interface Exports {
  memory: WebAssembly.Memory;
  start(now: number): number;
  advance(now: number): void;
  input(bytes: number): number;
  receive(now: number): void;
  next(): number;
  message(): number;
  message_bytes(): number;
}

/** The module with its memory. */
export class Devices {
  private readonly encoder = new TextEncoder();
  private readonly decoder = new TextDecoder();

  constructor(private readonly exports: Exports) {}

  static async load(module: BufferSource): Promise<Devices> {
    const { instance } = await WebAssembly.instantiate(module, {});
    return new Devices(instance.exports as unknown as Exports);
  }

  /** Starts the devices. */
  start(now: number): void {
    if (this.exports.start(now) !== 1) throw new Error(this.decoder.decode(this.message()));
  }

  advance(now: number): void {
    this.exports.advance(now);
  }

  receive(message: object, now: number): void {
    const bytes = this.encoder.encode(JSON.stringify(message));
    const place = this.exports.input(bytes.length);
    new Uint8Array(this.exports.memory.buffer, place, bytes.length).set(bytes);
    this.exports.receive(now);
  }

  /** All messages for the page. */
  *messages(): Generator<string | ArrayBuffer> {
    for (let kind = this.exports.next(); kind === TEXT || kind === SAMPLES; kind = this.exports.next()) {
      const message = this.message();
      yield kind === TEXT ? this.decoder.decode(message) : message.buffer;
    }
  }

  /** A copy: the memory moves when it grows. */
  private message(): Uint8Array<ArrayBuffer> {
    return new Uint8Array(this.exports.memory.buffer, this.exports.message(), this.exports.message_bytes()).slice();
  }
}

const now = () => performance.timeOrigin + performance.now();

export class Local implements Transport {
  private devices: Devices | null = null;
  heard = performance.now();
  malformed = 0;
  readonly waits = 0;
  loading = true;

  constructor(url: string, private readonly listener: Listener) {
    this.load(url).catch((error: unknown) => this.fail(error));
  }

  get connected(): boolean {
    return this.devices !== null;
  }

  /** There is no connection that could break. */
  keep(): void {}

  send(message: object): boolean {
    if (this.devices === null) return false;
    this.attempt((devices) => devices.receive(message, now()));
    return true;
  }

  private async load(url: string): Promise<void> {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`${url}: ${answer.status} ${answer.statusText}`);
    const devices = await Devices.load(await answer.arrayBuffer());
    devices.start(now());
    this.devices = devices;
    this.loading = false;
    this.listener.opened();
    every(ADVANCE_EVERY, () => this.attempt((running) => running.advance(now())));
  }

  /** Runs something on the devices. Their messages are handed on later, as from a server, so that the sender can wait for them. */
  private attempt(run: (devices: Devices) => void): void {
    if (this.devices === null) return;
    try {
      run(this.devices);
    } catch (error) {
      this.fail(error);
    }
    queueMicrotask(() => this.handOn());
  }

  private handOn(): void {
    for (const data of this.devices?.messages() ?? []) {
      this.heard = performance.now();
      if (!deliver(data, this.listener)) this.malformed += 1;
    }
  }

  private fail(error: unknown): void {
    console.error(error);
    this.devices = null;
    this.loading = false;
    this.listener.closed(`The demonstration has stopped: ${error instanceof Error ? error.message : error}. Reload this page`, false);
  }
}
