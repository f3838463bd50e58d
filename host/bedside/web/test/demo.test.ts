// The committed module of the page without a server: its samples are, bit for bit, those of the same devices on the host.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";
import { Module } from "../src/module";

const DEMO = process.env.DEMO ?? "../../../docs/demo";
const SAMPLES = 1000;
const HEADER_BYTES = 24;

/** Hash of the first samples of each device, from `host/webdemo/tests/demo.rs`. */
async function golden(): Promise<Map<number, string>> {
  const text = await readFile("../../webdemo/golden.txt", "utf8");
  return new Map(text.trim().split("\n").map((line) => { const [device = "", hash = ""] = line.split(" "); return [Number(device), hash]; }));
}

/** FNV-1a of pressures and commands of the inspiratory valve. */
function hash(pairs: Uint8Array[]): string {
  let value = 0xcbf29ce484222325n;
  for (const bytes of pairs) for (const byte of bytes) value = BigInt.asUintN(64, (value ^ BigInt(byte)) * 0x100000001b3n);
  return value.toString(16).padStart(16, "0");
}

/** Pressure and command of each sample of a message. */
function pairs(data: ArrayBuffer): Uint8Array[] {
  const count = new DataView(data).getUint16(2, true);
  const value = (column: number, index: number) => new Uint8Array(data, HEADER_BYTES + 4 * (column * count + index), 4);
  return Array.from({ length: count }, (_, index) => [value(0, index), value(2, index)]).flat();
}

test("the samples are those of the same devices on the host, bit for bit", async () => {
  const devices = await Module.load(new Uint8Array(await readFile(`${DEMO}/demo.wasm`)));
  let now = 1.7e12;
  devices.start(now);
  const found = new Map<number, Uint8Array[]>();
  const begin = performance.now();
  for (let step = 0; step < 75; step += 1) {
    now += 20;
    devices.advance(now);
    for (const data of devices.messages()) {
      if (typeof data === "string") continue;
      const device = new Uint8Array(data)[1] ?? 0;
      found.set(device, [...(found.get(device) ?? []), ...pairs(data)]);
    }
  }
  console.log(`1.5 s of ${found.size} devices in ${(performance.now() - begin).toFixed(0)} ms`);
  const hashes = new Map([...found].map(([device, all]) => [device, hash(all.slice(0, 2 * SAMPLES))]));
  assert.deepEqual(hashes, await golden());
});
