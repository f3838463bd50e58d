// The page against the real server: `trainer serve`, named by the environment's TRAINER, on a simulated device.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { launch, missing, open, painted, SHOTS, sleep, until } from "./browser.mjs";

const { TRAINER } = process.env;
const skip = missing || (TRAINER ? false : "no TRAINER: name the trainer binary");
const PORT = 8471;

let browser;
before(async () => { if (!skip) browser = await launch(); });
after(async () => { await browser?.close(); });

/** Starts the server and waits for the address that it prints. */
function serve(...args) {
  const child = spawn(TRAINER, ["serve", ...args, "--listen", `127.0.0.1:${PORT}`], { stdio: ["ignore", "pipe", "pipe"] });
  child.stderr.resume();
  return new Promise((resolve, reject) => {
    child.stdout.on("data", (text) => resolve({ child, url: String(text).trim() }));
    child.on("exit", (code) => reject(new Error(`trainer serve ended with ${code}`)));
  });
}

async function scene(args, run) {
  const server = await serve(...args);
  const page = await open(browser, server.url);
  try {
    await until(page, () => window.eupnea?.devices.length > 0);
    await run(page, server);
    assert.deepEqual(page.errors, []);
    assert.deepEqual(page.outside, []);
  } finally {
    await page.context().close();
    server.child.kill("SIGKILL");
  }
}

const startVentilation = async (page) => {
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await until(page, () => !document.querySelector("#setting-pip").disabled);
  if (await page.getByRole("button", { name: "Stop ventilation" }).count()) return;
  await page.getByRole("button", { name: "Start ventilation" }).click();
  await page.locator("dialog .agree").click();
  await page.getByRole("button", { name: "Stop ventilation" }).waitFor({ timeout: 60_000 });
};

test("a simulated device: start, waveforms, settings round trip, marker, stop", { skip, timeout: 240_000 }, () => scene(["--bench", "R20C20", "--steer"], async (page) => {
  await startVentilation(page);
  await until(page, () => window.eupnea.devices[0].breath?.number > 1, undefined, 60_000);
  for (const strip of ["pressure", "flow", "volume", "valves"]) assert.ok((await painted(page, strip)) > 300, strip);
  await page.locator("#setting-pip").fill("24");
  await page.locator("#setting-pip").press("Enter");
  await until(page, () => window.eupnea.devices[0].state.settings.pip === 24, undefined, 60_000);
  await until(page, () => document.querySelector("#setting-pip").closest("tr").querySelector(".applied").textContent === "24");
  await until(page, () => Math.abs(window.eupnea.devices[0].breath.pip - 24) < 3, undefined, 60_000);
  await page.getByRole("tab", { name: "Record" }).click();
  await page.getByRole("button", { name: "Set marker" }).click();
  await until(page, () => /marker/i.test(document.querySelector(".log li")?.textContent ?? ""));
  const { lost, malformed } = await page.evaluate(() => ({ lost: window.eupnea.devices[0].ring.missing, malformed: window.eupnea.socket.malformed }));
  assert.deepEqual([lost, malformed], [0, 0]);
  await page.screenshot({ path: join(SHOTS, "real-bench.png") });
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Stop ventilation" }).click();
  await page.locator("dialog .agree").click();
  await page.getByRole("button", { name: "Start ventilation" }).waitFor({ timeout: 60_000 });
}));

test("the page finds a server that died", { skip, timeout: 120_000 }, () => scene(["--bench", "R20C20"], async (page, server) => {
  await until(page, () => window.eupnea.devices[0].state?.connected === true);
  server.child.kill("SIGKILL");
  await until(page, () => !document.querySelector(".shade").hidden && /No data/.test(document.querySelector("#banner").textContent));
  await sleep(1000);
  server.child = (await serve("--bench", "R20C20")).child;
  await until(page, () => document.querySelector(".connection").textContent === "Connected" && document.querySelector(".shade").hidden);
  await until(page, () => document.querySelector("#banner").dataset.priority === "none");
}));

test("the demo: a fault raises an alarm on the wall", { skip, timeout: 240_000 }, () => scene(["--demo"], async (page) => {
  await until(page, () => window.eupnea.devices.filter(({ breath }) => breath).length > 8, undefined, 90_000);
  assert.equal(await page.locator(".pair").count(), 9);
  await page.screenshot({ path: join(SHOTS, "real-wall.png") });
  await page.locator(".card-open").last().click();
  await page.getByRole("button", { name: "Disconnect" }).click();
  await until(page, () => document.querySelector("#banner").dataset.priority === "high", undefined, 60_000);
  await page.screenshot({ path: join(SHOTS, "real-alarm.png") });
  await page.getByRole("button", { name: "Wall" }).click();
  await until(page, () => document.querySelector(".card .banner").closest(".group-of-cards").querySelector('[data-priority="high"]') !== null);
}));
