// The page against the real server: `trainer serve`, named by the environment's TRAINER, on a simulated device, and on the real image in
// QEMU, whose images are in the environment's IMAGES.

import assert from "node:assert/strict";
import { mkdtemp, readFile, rm } from "node:fs/promises";
import { createServer } from "node:http";
import { networkInterfaces, tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { launch, open, SHOTS, sleep, until, WHOLE } from "./browser.mjs";
import { board, breathes, run, skip, skipBoard, startVentilation } from "./trainer.mjs";

/** The policy that the server must send, from its source. */
const POLICY = /CONTENT_SECURITY_POLICY: &str = "(.*)";/.exec(await readFile(new URL("../../src/guard.rs", import.meta.url), "utf8"))[1];

let browser;
let folder;
before(async () => {
  if (skip) return;
  browser = await launch();
  folder = await mkdtemp(join(tmpdir(), "bedside-"));
});
after(async () => {
  await browser?.close();
  if (folder) await rm(folder, { recursive: true });
});

/** A server on a free port or on this one, of this computer alone or of the network with this address. */
async function serve(args, port = 0, host = "127.0.0.1") {
  const { found: [url, own], kill } = await run(["serve", ...args, "--records", folder, "--listen", `${host}:${port}`], /http:\/\/[\d.]+:(\d+)\S*(?=\n)/);
  return { url, port: Number(own), kill };
}

/** Runs a test on a page of a server; scripts must not fail, and nothing outside may be asked for. */
async function scene(args, run_, host = undefined) {
  const server = await serve(args, 0, host);
  const page = await open(browser, server.url);
  try {
    await until(page, () => window.eupnea?.devices.length > 0);
    await run_(page, server);
    assert.deepEqual(page.errors, []);
    assert.deepEqual(page.outside, []);
  } finally {
    await page.context().close();
    await server.kill();
  }
}

/** Reads the device's flight recorder, which holds the running ventilation. */
async function readRecorder(page) {
  await page.getByRole("tab", { name: "Record" }).click();
  await page.getByRole("button", { name: "Read the flight recorder" }).click();
  await until(page, () => document.querySelectorAll(".record .chart canvas").length === 4);
  const { fast, slow, events } = await page.evaluate(() => window.eupnea.devices[0].recorder);
  assert.ok(fast.time.length > 1000 && slow.time.length > 50, `${fast.time.length} and ${slow.time.length} ticks`);
  // The fast ticks are of 2 s at most, as long as an expiration: only the slow ones hold an inspiration for certain.
  assert.ok(Math.max(...slow.pressure) > 10 && Math.max(...slow.u_in) > 0);
  assert.ok(Math.max(...fast.pressure) > 1, "the lung holds PEEP at least");
  assert.ok(events.some(({ text }) => text === "ventilation started"), JSON.stringify(events));
}

test("a simulated device: start, waveforms, settings round trip, marker, flight recorder, stop", { skip, timeout: WHOLE }, () => scene(["--bench", "R20C20", "--steer"], async (page) => {
  await startVentilation(page);
  await breathes(page);
  await page.locator("#setting-pip").fill("24");
  await page.locator("#setting-pip").press("Enter");
  await until(page, () => window.eupnea.devices[0].state.settings.pip === 24);
  await until(page, () => document.querySelector("#setting-pip").closest("tr").querySelector(".applied").textContent === "24");
  await until(page, () => Math.abs(window.eupnea.devices[0].breath.pip - 24) < 3);
  await page.getByRole("tab", { name: "Record" }).click();
  await page.getByRole("button", { name: "Set marker" }).click();
  await until(page, () => /marker/i.test(document.querySelector(".log li")?.textContent ?? ""));
  const { lost, malformed } = await page.evaluate(() => ({ lost: window.eupnea.devices[0].ring.missing, malformed: window.eupnea.socket.malformed }));
  assert.deepEqual([lost, malformed], [0, 0]);
  await page.screenshot({ path: join(SHOTS, "real-bench.png") });
  await readRecorder(page);
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Stop ventilation" }).click();
  await page.locator("dialog .agree").click();
  await page.getByRole("button", { name: "Start ventilation" }).waitFor();
}));

// 46 breaths of 1.5 s, and those until they begin.
test("the margins of a simulated device are measured after a confirmation, and its settings come back", { skip, timeout: WHOLE }, () => scene(["--bench", "R20C20", "--steer"], async (page) => {
  await startVentilation(page);
  await page.locator("#setting-rate").fill("40");
  await page.locator("#setting-rate").press("Enter");
  await until(page, () => window.eupnea.devices[0].state.settings.rate === 40);
  await page.getByRole("tab", { name: "Tuning" }).click();
  await page.getByLabel("Frequencies").fill("8");
  await page.getByLabel("Breaths at each").fill("5");
  await page.getByRole("button", { name: "Measure margins" }).click();
  await page.locator("dialog .agree").click();
  await until(page, () => window.eupnea.devices[0].state.measuring?.breath > 2 && window.eupnea.devices[0].state.settings.rise_time === 1);
  assert.match(await page.locator(".tuning > [role=status]").first().textContent(), /^Measuring: breath \d+ of 46/);
  await until(page, () => document.querySelectorAll(".margins .limits tbody tr").length === 3);
  const { refused, margins, remarks, charts } = await page.evaluate(() => window.eupnea.devices[0].margins);
  assert.deepEqual([refused, charts.length], [null, 5]);
  for (const { value, unstated, low, high } of margins) assert.ok(value === null ? unstated : low < value && value < high, JSON.stringify(margins));
  assert.match(remarks.join(), /\d of 8 frequencies count/);
  await page.screenshot({ path: join(SHOTS, "real-margins.png") });
  await until(page, () => window.eupnea.devices[0].state.settings.rise_time === 0 && window.eupnea.devices[0].state.ventilating);
}));

/** An address at which other computers reach this one; undefined if it has none. */
const reachable = Object.values(networkInterfaces()).flat().find(({ family, internal }) => family === "IPv4" && !internal)?.address;

// Such a page is no secure context: the browser withholds functions that it offers at a loopback address.
test("at an address of the network the page works, and even reading needs the token", { skip: skip || (reachable ? false : "this computer has no network"), timeout: WHOLE }, () => scene(["--bench", "R20C20", "--steer"], async (page, { url }) => {
  assert.equal(new URL(url).hostname, reachable);
  assert.equal(await page.evaluate(() => isSecureContext), false);
  await startVentilation(page);
  await breathes(page);
  const { origin } = new URL(url);
  for (const path of ["/api/state", "/metrics"]) assert.equal((await fetch(origin + path)).status, 403, path);
  const stranger = await open(browser, origin);
  // Several attempts of the page to open the stream.
  await sleep(3000);
  assert.equal(await stranger.evaluate(() => window.eupnea.devices.length), 0);
  await stranger.context().close();
}, reachable));

test("the page finds a server that died", { skip, timeout: WHOLE }, () => scene(["--bench", "R20C20"], async (page, server) => {
  await until(page, () => window.eupnea.devices[0].state?.connected === true);
  await server.kill();
  await until(page, () => !document.querySelector(".shade").hidden && /No data/.test(document.querySelector("#banner").textContent));
  await until(page, () => window.eupnea.socket.attempts > 1);
  server.kill = (await serve(["--bench", "R20C20"], server.port)).kill;
  await until(page, () => document.querySelector(".connection").textContent === "Connected" && document.querySelector(".shade").hidden);
  await until(page, () => document.querySelector("#banner").dataset.priority === "none");
}));

test("a board that dies is told, and ventilates again after its return", { skip: skipBoard, timeout: WHOLE }, async () => {
  let device = await board();
  try {
    await scene(["--port", `tcp:127.0.0.1:${device.port}`, "--steer"], async (page) => {
      await startVentilation(page);
      await breathes(page);
      await readRecorder(page);
      await device.kill();
      await until(page, () => document.querySelector(".shade").textContent === "Device not connected" && !document.querySelector(".shade").hidden);
      await until(page, () => document.querySelector("#banner").dataset.priority === "high" && /not connected/.test(document.querySelector("#banner").textContent));
      device = await board(device.port);
      await until(page, () => window.eupnea.devices[0].state.connected && document.querySelector(".shade").hidden);
      const before = await page.evaluate(() => window.eupnea.devices[0].ring.end);
      await startVentilation(page);
      await until(page, (known) => window.eupnea.devices[0].ring.end > known + 1000 && window.eupnea.devices[0].ring.newest < 60_000, before);
    });
  } finally {
    await device.kill();
  }
});

test("the policy comes with every file, and forbids the page to reach anything else", { skip, timeout: WHOLE }, async () => {
  let asked = 0;
  const stranger = createServer((_, response) => { asked += 1; response.end(); });
  await new Promise((resolve) => stranger.listen(0, "127.0.0.1", resolve));
  try {
    await scene(["--bench", "R20C20"], async (page) => {
      assert.equal(page.response.headers()["content-security-policy"], POLICY);
      for (const path of ["app.js", "app.css", "api/state", "metrics", "nothing"]) {
        const { headers } = await page.evaluate(async (address) => ({ headers: [...(await fetch(address)).headers] }), `/${path}`);
        assert.equal(Object.fromEntries(headers)["content-security-policy"], POLICY, path);
      }
      const directives = await page.evaluate(async (address) => {
        const seen = [];
        document.addEventListener("securitypolicyviolation", ({ effectiveDirective }) => seen.push(effectiveDirective));
        const insert = (tag, properties) => document.body.append(Object.assign(document.createElement(tag), properties));
        await fetch(address).catch(() => {});
        try { new WebSocket(address.replace("http", "ws")); } catch { /* Some browsers throw. */ }
        navigator.sendBeacon(address, "x");
        insert("img", { src: `${address}i.png` });
        insert("script", { src: `${address}s.js` });
        insert("script", { textContent: "window.foreign = true" });
        insert("link", { rel: "stylesheet", href: `${address}s.css` });
        insert("iframe", { src: address });
        insert("video", { src: address });
        for (const begin = performance.now(); seen.length < 9 && performance.now() - begin < 10_000;) await new Promise((resolve) => setTimeout(resolve, 20));
        return [seen, window.foreign];
      }, `http://127.0.0.1:${stranger.address().port}/`);
      assert.deepEqual(directives[0].sort(), ["connect-src", "connect-src", "connect-src", "frame-src", "img-src", "media-src", "script-src-elem", "script-src-elem", "style-src-elem"]);
      assert.equal(directives[1], undefined, "the script did not run");
      assert.equal(asked, 0, "no request reached the other server");
      // These were the attempts of the test.
      page.errors.length = 0;
      page.outside.length = 0;
    });
  } finally {
    stranger.close();
  }
});

test("the demo: a fault raises an alarm on the wall", { skip, timeout: WHOLE }, () => scene(["--demo"], async (page) => {
  await until(page, () => window.eupnea.devices.filter(({ breath }) => breath).length > 8);
  assert.equal(await page.locator(".pair").count(), 9);
  await page.screenshot({ path: join(SHOTS, "real-wall.png") });
  await page.locator(".card-open").last().click();
  await page.getByRole("button", { name: "Disconnect" }).click();
  await until(page, () => document.querySelector("#banner").dataset.priority === "high");
  await page.screenshot({ path: join(SHOTS, "real-alarm.png") });
  await page.getByRole("button", { name: "Wall" }).click();
  await until(page, () => document.querySelector(".card .banner").closest(".group-of-cards").querySelector('[data-priority="high"]') !== null);
}));
