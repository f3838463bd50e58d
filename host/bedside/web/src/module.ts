// The WebAssembly module: the demonstration's devices, the link of a real board, and flashing. Only numbers and bytes pass.

import type { Transfer } from "./usb";

/** What `next` has found. */
const TEXT = 1;
const SAMPLES = 2;
/** What `transfer` has found. */
const [DONE, OUT, IN] = [0, 1, 2];

/** What the module exports, as `host/webdemo/src/exports.rs` defines it; times are in ms since 1970. */
interface Exports {
  memory: WebAssembly.Memory;
  start(now: number): number;
  advance(now: number): void;
  input(bytes: number): number;
  receive(now: number): void;
  next(): number;
  message(): number;
  message_bytes(): number;
  connect(token: number, first: number): void;
  hear(now: number): void;
  wire(): void;
  unplugged(now: number): void;
  leave(): void;
  release_key(): void;
  open_release(): number;
  begin_flash(): number;
  transfer(): number;
  took(result: number): number;
  flashed(): number;
}

/** What a release says of its firmware. */
export interface Firmware {
  version: string;
  revision: string;
  board: string;
  image: string;
}

export class Module {
  private readonly encoder = new TextEncoder();
  private readonly decoder = new TextDecoder();

  constructor(private readonly exports: Exports) {}

  static async load(module: BufferSource): Promise<Module> {
    const { instance } = await WebAssembly.instantiate(module, {});
    return new Module(instance.exports as unknown as Exports);
  }

  /** Starts the demonstration. */
  start(now: number): void {
    this.demand(this.exports.start(now));
  }

  advance(now: number): void {
    this.exports.advance(now);
  }

  receive(message: object, now: number): void {
    this.input(this.encoder.encode(JSON.stringify(message)));
    this.exports.receive(now);
  }

  /** All messages for the page. */
  *messages(): Generator<string | ArrayBuffer> {
    for (let kind = this.exports.next(); kind === TEXT || kind === SAMPLES; kind = this.exports.next()) {
      const message = this.message();
      yield kind === TEXT ? this.decoder.decode(message) : message.buffer;
    }
  }

  /** Shows the board of a port that was just opened. */
  connect(token: number, first: number): void {
    this.exports.connect(token, first);
  }

  /** Takes bytes of its port. */
  hear(bytes: Uint8Array, now: number): void {
    this.input(bytes);
    this.exports.hear(now);
  }

  /** Bytes to write to its port. */
  wire(): Uint8Array {
    this.exports.wire();
    return this.message();
  }

  unplugged(now: number): void {
    this.exports.unplugged(now);
  }

  /** Leaves the board for the demonstration; the last bytes for the port. */
  leave(): Uint8Array {
    this.exports.leave();
    return this.message();
  }

  /** The key that the module trusts by itself, or "". */
  releaseKey(): string {
    this.exports.release_key();
    return this.decoder.decode(this.message());
  }

  /** Verifies a release file; fails with the reason. */
  openRelease(key: string, file: Uint8Array): Firmware {
    const head = this.encoder.encode(`${key.trim()}\n`);
    const whole = new Uint8Array(head.length + file.length);
    whole.set(head);
    whole.set(file, head.length);
    this.input(whole);
    return JSON.parse(this.demand(this.exports.open_release())) as Firmware;
  }

  /** Begins to flash it into the chip whose boot loader has this name; fails with the reason. */
  beginFlash(name: string): void {
    this.input(this.encoder.encode(name));
    this.demand(this.exports.begin_flash());
  }

  /** The next transfer; null if all is done. */
  transfer(): Transfer | null {
    const kind = this.exports.transfer();
    const message = this.message();
    const view = new DataView(message.buffer);
    if (kind === DONE) return null;
    if (kind === OUT) return { request: view.getUint8(0), value: view.getUint16(1, true), data: message.subarray(3) };
    if (kind === IN) return { request: view.getUint8(0), value: view.getUint16(1, true), length: view.getUint16(3, true) };
    return { wait: view.getUint32(0, true) };
  }

  /** Takes the result of that transfer; fails with the reason if flashing ends here. */
  took(result: number, data: Uint8Array): void {
    this.input(data);
    this.demand(this.exports.took(result));
  }

  flashed(): number {
    return this.exports.flashed();
  }

  /** The message, if a call has succeeded; otherwise it is the reason. */
  private demand(ok: number): string {
    const text = this.decoder.decode(this.message());
    if (ok !== 1) throw new Error(text);
    return text;
  }

  private input(bytes: Uint8Array): void {
    const place = this.exports.input(bytes.length);
    new Uint8Array(this.exports.memory.buffer, place, bytes.length).set(bytes);
  }

  /** A copy: the memory moves when it grows. */
  private message(): Uint8Array<ArrayBuffer> {
    return new Uint8Array(this.exports.memory.buffer, this.exports.message(), this.exports.message_bytes()).slice();
  }
}
