// The page without a server with boards at its computer: flashing a boot loader in software by WebUSB, and the real image in QEMU behind a
// port of Web Serial.

import assert from "node:assert/strict";
import { connect } from "node:net";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { WebSocketServer } from "ws";
import { KEY, release, zip } from "../dev/release.mjs";
import { serial, usb } from "../dev/software_devices.mjs";
import { files } from "./files.mjs";
import { launch, missing, open, says, SHOTS, until, WHOLE } from "./browser.mjs";
import { board, breathes, skipBoard, startVentilation } from "./trainer.mjs";

const F405 = "@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg";
const F446 = "@Internal Flash  /0x08000000/04*016Kg,01*064Kg,03*128Kg";
const PROGRAM = Buffer.from(Array.from({ length: 9001 }, (_, index) => (7 * index) % 251));
const WEIGHTS = Buffer.alloc(3000, 5);

let browser;
let server;
before(async () => {
  if (missing) return;
  browser = await launch();
  server = await files();
});
after(async () => {
  await browser?.close();
  server?.close();
});

/** A page with this boot loader, in whose dialog a release file was chosen. */
async function choose(device, file, key = KEY) {
  const page = await open(browser, server.url, { devices: device && [usb, device] });
  await until(page, () => window.eupnea?.devices.length === 18);
  await page.getByRole("button", { name: "Flash a board" }).click();
  await page.locator("#release-key").fill(key);
  await page.locator("#release-file").setInputFiles({ name: "eupnea-0.1.0-stm32f405.zip", mimeType: "application/zip", buffer: file });
  return page;
}

/** Presses Flash, confirms, and waits for what the page says at the end. */
async function flash(page, end) {
  await says(page, "dialog .result", "The main board 0.1.0 (revision abc) for stm32f405: signature and files verified.");
  await page.locator("dialog .start").click();
  await page.locator("dialog .agree").click();
  await says(page, "dialog .result", end);
  assert.deepEqual(page.errors, []);
  assert.deepEqual(page.outside, []);
}

const GOOD = zip(release(PROGRAM, WEIGHTS));
const scene = (name, run) => test(name, { skip: missing, timeout: WHOLE }, run);

scene("a release is verified, flashed by USB and read back", async () => {
  const page = await choose({ layout: F405 }, GOOD);
  await flash(page, "Flashed and read back. Set BOOT0 low and press the board's reset button.");
  const { bytes, others, erased, written, state } = await page.evaluate(([program, weights]) => {
    const { flash: map, ...rest } = window.rom;
    const read = (from, count) => Array.from({ length: count }, (_, index) => map.get(from + index));
    return { ...rest, others: map.size - program - weights, bytes: [...read(0x08000000, program), ...read(0x080c0000, weights)] };
  }, [PROGRAM.length, WEIGHTS.length]);
  assert.deepEqual(Buffer.from(bytes), Buffer.concat([PROGRAM, WEIGHTS]));
  assert.deepEqual([others, erased, state], [0, [0x08000000, 0x080c0000], 2]);
  assert.equal(written.at(-1), 0x08000000, "the vector table comes last");
  await page.screenshot({ path: join(SHOTS, "flash.png") });
  await page.context().close();
});

scene("a board that is unplugged in the middle, or refuses, is told with what to do", async () => {
  for (const [device, told] of [
    [{ layout: F405, lives: 30 }, /^Not flashed: the board does not answer any more: connect it again with BOOT0 high and repeat/],
    [{ layout: F405, locked: 0x080c0000 }, /^Not flashed: the chip refuses address 0x080c0000 \(DFU status 4\): set all bits of nWRP to 1/],
    [{ layout: F446 }, /^Not flashed: this is the firmware of another board: its chip STM32F405RG has 1024 KiB of flash, the connected one 512/],
    [{ layout: "@Option Bytes  /0x1FFFC000/01*016 e" }, /^Not flashed: the USB device describes no flash/],
  ]) {
    const page = await choose(device, GOOD);
    await flash(page, told);
    assert.equal(await page.evaluate(() => window.rom.flash.has(0x08000000)), false, "no half program");
    assert.equal(await page.locator("dialog .start").isEnabled(), true, "it can be repeated");
    await page.context().close();
  }
});

scene("a file that is damaged, unsigned or signed by another key is refused with what to do", async () => {
  const good = release(PROGRAM, WEIGHTS);
  const { "manifest.sig": _, ...unsigned } = good;
  for (const [file, key, told] of [
    [zip({ ...good, "weights.bin": Buffer.alloc(3000, 6) }), KEY, /^Refused: weights.bin is damaged: download the release file again/],
    [zip(unsigned), KEY, /^Refused: it is not signed: take the file of a release/],
    [GOOD.subarray(0, GOOD.length / 2), KEY, /^Refused: it is no ZIP archive, or not all of it/],
    [GOOD, KEY.replace(/^../, (byte) => (byte === "00" ? "01" : "00")), /^Refused: it is signed by the key [0-9a-f]{64}, but [0-9a-f]{64} is trusted/],
    [GOOD, "", /^Refused: name the public key of the release/],
    [zip(release(PROGRAM, WEIGHTS, { usb_dfu: false })), KEY, /^Refused: the board stm32f405 has no USB/],
  ]) {
    const page = await choose({ layout: F405 }, file, key);
    await says(page, "dialog .result", told);
    assert.equal(await page.locator("dialog .start").isDisabled(), true);
    assert.deepEqual(page.errors, []);
    await page.context().close();
  }
});

scene("a browser without WebUSB or Web Serial is told what to use instead", async () => {
  const without = () => { for (const name of ["usb", "serial"]) Object.defineProperty(navigator, name, { value: undefined }); };
  const page = await open(browser, server.url, { devices: [without] });
  await until(page, () => window.eupnea?.devices.length === 18);
  await page.getByRole("button", { name: "Connect a board" }).click();
  await says(page, ".boards .note", /no Web Serial: use Chromium, Chrome or Edge/);
  await page.getByRole("button", { name: "Flash a board" }).click();
  await page.locator("#release-key").fill(KEY);
  await page.locator("#release-file").setInputFiles({ name: "a.zip", mimeType: "application/zip", buffer: GOOD });
  await flash(page, /^Not flashed: This browser has no WebUSB: use Chromium, Chrome or Edge/);
  await page.context().close();
});

/** Carries bytes between the page's port and a board; ends the line when asked to. */
function carry(port) {
  const sockets = new WebSocketServer({ server: server.server, path: "/serial" });
  sockets.on("connection", (socket) => {
    const line = connect(port, "127.0.0.1");
    line.on("data", (bytes) => socket.send(bytes));
    line.on("close", () => socket.close());
    line.on("error", () => socket.close());
    socket.on("message", (bytes) => line.write(bytes));
    socket.on("close", () => line.destroy());
  });
  return { unplug: () => { for (const socket of sockets.clients) socket.terminate(); }, close: () => sockets.close() };
}

test("the real image in QEMU by Web Serial: start, waveforms, a setting, unplugging, stop", { skip: skipBoard, timeout: WHOLE }, async () => {
  const qemu = await board();
  const port = carry(qemu.port);
  const page = await open(browser, server.url, { devices: [serial] });
  try {
    await until(page, () => window.eupnea?.devices.length === 18);
    await page.getByRole("button", { name: "Connect a board" }).click();
    await until(page, () => window.eupnea.devices.length === 1 && window.eupnea.devices[0].state?.connected);
    assert.deepEqual(await page.evaluate(() => [window.serialOptions.baudRate, window.eupnea.devices[0].info.kind]), [1_000_000, "hil"]);
    await startVentilation(page);
    await breathes(page);
    await page.locator("#setting-pip").fill("22");
    await page.locator("#setting-pip").press("Enter");
    await until(page, () => window.eupnea.devices[0].state.settings.pip === 22);
    await page.screenshot({ path: join(SHOTS, "web-serial.png") });
    const tick = await page.evaluate(() => window.eupnea.devices[0].ring.newest);
    await page.evaluate(() => window.damage());
    await until(page, (before) => window.eupnea.devices[0].ring.newest > before + 2000, tick);
    assert.equal(await page.locator(".boards .note").textContent(), "", "a damaged byte is no end of the line");
    port.unplug();
    await says(page, ".boards .note", "The board was unplugged. Plug it in and connect it again.");
    await until(page, () => window.eupnea.devices[0].state.connected === false && !window.eupnea.devices[0].yours);
    await page.getByRole("button", { name: "Connect a board" }).click();
    await until(page, () => window.eupnea.devices[0].state.connected && window.eupnea.devices[0].state.ventilating);
    // The board went on, and nothing was pushed.
    await until(page, () => window.eupnea.devices[0].state.settings.pip === 22);
    await page.getByRole("button", { name: "Take control" }).click();
    await page.getByRole("button", { name: "Stop ventilation" }).click();
    await page.locator("dialog .agree").click();
    await until(page, () => window.eupnea.devices[0].state.ventilating === false);
    await page.getByRole("button", { name: "Disconnect the board" }).click();
    await until(page, () => window.eupnea.devices.length === 18);
    assert.equal(await page.evaluate(() => window.eupnea.socket.malformed), 0);
    assert.deepEqual(page.errors, []);
    assert.deepEqual(page.outside, []);
  } finally {
    await page.context().close();
    port.close();
    await qemu.kill();
  }
});
