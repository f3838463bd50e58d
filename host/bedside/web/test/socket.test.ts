// The connection: given up when it is silent, opened again when that is due, by the calls of `keep` alone.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Socket } from "../src/socket";

/** Stands for the browser's socket. */
class Stub {
  static readonly OPEN = 1;
  static all: Stub[] = [];
  readyState = 0;
  closings = 0;
  onopen: (() => void) | null = null;
  onmessage: ((event: { data: string }) => void) | null = null;
  onclose: ((event: { reason: string; code: number }) => void) | null = null;

  constructor() {
    Stub.all.push(this);
  }

  close(): void {
    this.closings += 1;
  }

  open(): void {
    this.readyState = Stub.OPEN;
    this.onopen?.();
  }
}

/** A socket whose attempts are in `Stub.all`, and how often its listener was told that it closed. */
function socket(): { socket: Socket; closed: () => number } {
  Object.assign(globalThis, { WebSocket: Stub });
  Stub.all = [];
  let closed = 0;
  const listener = { opened: () => {}, closed: () => { closed += 1; }, message: () => {}, samples: () => {} };
  return { socket: new Socket("ws://localhost/", listener), closed: () => closed };
}

/** Calls `keep` ten times a second over a time, ms. */
function keep(one: Socket, from: number, to: number): void {
  for (let at = from; at <= to; at += 100) one.keep(at);
}

test("a silent connection is given up after 5 s without waiting for its end, and opened again", () => {
  const { socket: one, closed } = socket();
  const begin = performance.now();
  Stub.all[0]?.open();
  keep(one, begin, begin + 4_900);
  assert.deepEqual([Stub.all[0]?.closings, one.connected], [0, true]);
  keep(one, begin + 5_000, begin + 5_200);
  assert.deepEqual([Stub.all[0]?.closings, one.connected, closed()], [1, false, 1]);
  keep(one, begin + 5_300, begin + 6_000);
  assert.equal(Stub.all.length, 2);
  assert.equal(Stub.all[0]?.onclose, null, "nothing more of the first one counts");
});

test("an attempt that does not open is given up after 4 s", () => {
  const { socket: one } = socket();
  const begin = performance.now();
  keep(one, begin, begin + 3_900);
  assert.equal(Stub.all[0]?.closings, 0);
  keep(one, begin + 4_000, begin + 4_200);
  assert.equal(Stub.all[0]?.closings, 1);
});

test("a page that was held up first reads the messages that wait", () => {
  const { socket: one } = socket();
  const begin = performance.now();
  Stub.all[0]?.open();
  keep(one, begin, begin + 1_000);
  keep(one, begin + 60_000, begin + 64_900);
  assert.deepEqual([Stub.all[0]?.closings, one.connected], [0, true]);
  keep(one, begin + 65_000, begin + 65_200);
  assert.equal(Stub.all[0]?.closings, 1);
});
