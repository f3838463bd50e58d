// The page without a server in a real browser, from a plain server of files.

import assert from "node:assert/strict";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { launch, missing, open, painted, SHOTS, until, WHOLE } from "./browser.mjs";
import { files } from "./files.mjs";

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

const start = () => open(browser, server.url);

test("nine lungs breathe, waveforms move, and a fault raises an alarm", { skip: missing, timeout: WHOLE }, async () => {
  const page = await start();
  await until(page, () => window.eupnea?.devices.length === 18);
  assert.equal(await page.locator(".pair").count(), 9);
  await until(page, () => window.eupnea.devices.filter(({ breath }) => breath).length === 18);
  await page.screenshot({ path: join(SHOTS, "standalone-wall.png") });
  await page.locator(".card-open").last().click();
  const newest = () => page.evaluate(() => Math.max(...window.eupnea.devices.map(({ ring }) => ring.newest ?? 0)));
  const before = await newest();
  await until(page, (tick) => Math.max(...window.eupnea.devices.map(({ ring }) => ring.newest ?? 0)) > tick + 3000, before);
  for (const strip of ["pressure", "flow", "volume", "valves", "learned"]) assert.ok((await painted(page, strip)) > 300, strip);
  await page.getByRole("button", { name: "Disconnect" }).click();
  await until(page, () => document.querySelector("#banner").dataset.priority === "high");
  await page.screenshot({ path: join(SHOTS, "standalone-alarm.png") });
  await page.getByRole("button", { name: "Clear faults" }).click();
  await until(page, () => window.eupnea.devices.every(({ state }) => !state.alarms.some(({ present }) => present)));
  assert.equal(await page.evaluate(() => window.eupnea.socket.malformed), 0);
  assert.deepEqual(page.errors, []);
  assert.deepEqual(page.outside, []);
  await page.context().close();
});

test("settings are applied from the next breath on", { skip: missing, timeout: WHOLE }, async () => {
  const page = await start();
  await until(page, () => window.eupnea?.devices.length === 18);
  await page.locator(".card-open").first().click();
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await until(page, () => !document.querySelector("#setting-pip").disabled);
  await page.locator("#setting-pip").fill("18");
  await page.locator("#setting-pip").press("Enter");
  await until(page, () => window.eupnea.devices.some(({ state }) => state.settings.pip === 18));
  assert.deepEqual(page.errors, []);
  await page.context().close();
});

test("a module that is missing is told on the page", { skip: missing, timeout: WHOLE }, async () => {
  const page = await browser.newPage();
  await page.route("**/demo.wasm", (route) => route.fulfill({ status: 404 }));
  await page.goto(server.url);
  await until(page, () => /demo\.wasm: 404/.test(document.querySelector(".connection").textContent));
  await page.close();
});
