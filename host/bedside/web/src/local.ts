// The devices in the page itself: the demonstration's, at the pace of the page's clock, or a board at a port of this computer.

import { every } from "./beat";
import { Module } from "./module";
import type { SerialLine } from "./serial";
import { deliver, type Listener, type Transport } from "./transport";

/** Interval at which the devices go on, ms. */
const ADVANCE_EVERY = 20;

const random = () => crypto.getRandomValues(new Uint32Array(1))[0] ?? 0;
const now = () => performance.timeOrigin + performance.now();

export class Local implements Transport {
  /** The running module; null before it is loaded and after it has stopped. */
  module: Module | null = null;
  private line: SerialLine | null = null;
  /** Identifies this page to boards, also after a board was unplugged. */
  private readonly token = random();
  heard = performance.now();
  malformed = 0;
  readonly waits = 0;
  loading = true;

  constructor(url: string, private readonly listener: Listener) {
    this.load(url).catch((error: unknown) => this.fail(error));
  }

  get connected(): boolean {
    return this.module !== null;
  }

  /** There is no connection that could break. */
  keep(): void {}

  send(message: object): boolean {
    if (this.module === null) return false;
    this.attempt((module) => module.receive(message, now()));
    return true;
  }

  /** Shows the board on a line instead of the demonstration; `gone` when the line ends by itself. */
  connect(line: SerialLine, gone: () => void): void {
    this.line = line;
    this.attempt((module) => module.connect(this.token, random()));
    line.listen((bytes) => this.attempt((module) => module.hear(bytes, now())), () => {
      this.line = null;
      this.attempt((module) => module.unplugged(now()));
      gone();
    });
  }

  /** Leaves the board, which goes on as it is, and shows the demonstration again. */
  async leave(): Promise<void> {
    const { line } = this;
    this.line = null;
    this.attempt((module) => line?.write(module.leave()));
    await line?.close();
  }

  private async load(url: string): Promise<void> {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`${url}: ${answer.status} ${answer.statusText}`);
    const module = await Module.load(await answer.arrayBuffer());
    module.start(now());
    this.module = module;
    this.loading = false;
    this.listener.opened();
    every(ADVANCE_EVERY, () => this.attempt((running) => running.advance(now())));
  }

  /** Runs something in the module. Its messages are handed on later, as from a server, so that the sender can wait for them. */
  private attempt(run: (module: Module) => void): void {
    if (this.module === null) return;
    try {
      run(this.module);
      this.line?.write(this.module.wire());
    } catch (error) {
      this.fail(error);
    }
    queueMicrotask(() => this.handOn());
  }

  private handOn(): void {
    for (const data of this.module?.messages() ?? []) {
      this.heard = performance.now();
      if (!deliver(data, this.listener)) this.malformed += 1;
    }
  }

  private fail(error: unknown): void {
    console.error(error);
    this.module = null;
    this.loading = false;
    this.listener.closed(`The demonstration has stopped: ${error instanceof Error ? error.message : error}. Reload this page`, false);
  }
}
