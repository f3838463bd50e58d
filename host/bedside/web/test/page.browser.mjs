// The page in a real browser, against the fake server.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { Fake } from "../dev/fake.mjs";
import { launch, missing, open, painted, sleep, until } from "./browser.mjs";

let browser;
before(async () => { if (!missing) browser = await launch(); });
after(async () => { await browser?.close(); });

/** Runs a test on a page of a fake server of its own; scripts must not fail, and nothing outside may be asked for. */
function scene(name, options, run) {
  test(name, { skip: missing, timeout: 120_000 }, async () => {
    const fake = new Fake(options);
    const url = await fake.start();
    const page = await open(browser, url, options.page);
    try {
      await until(page, () => window.eupnea?.devices.length > 0);
      await run(page, fake, url);
      assert.deepEqual(page.errors, []);
      assert.deepEqual(page.outside, []);
    } finally {
      await page.context().close();
      await fake.stop();
    }
  });
}

const text = (page, selector) => page.locator(selector).first().textContent();
const newest = (page) => page.evaluate(() => window.eupnea.devices[0].ring.newest);

scene("waveforms are there, as pixels and as data, and no sample is missing", {}, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 4000);
  for (const strip of ["pressure", "flow", "volume", "valves", "learned"]) assert.ok((await painted(page, strip)) > 500, strip);
  assert.ok(fake.devices[0].lung.tick - (await newest(page)) < 1000);
  const { missing: lost, malformed } = await page.evaluate(() => ({ missing: window.eupnea.devices[0].ring.missing, malformed: window.eupnea.socket.malformed }));
  assert.deepEqual([lost, malformed], [0, 0]);
  await until(page, () => document.querySelector(".tile.large .value").textContent !== "--");
  assert.match(await text(page, ".tile.large .value"), /^20\.\d$/);
  for (let wait = 0; wait < 200 && fake.drawn.length <= 5; wait++) await sleep(50);
  assert.ok(fake.drawn.length > 5 && fake.drawn.every(({ device, tick }) => device === 0 && Number.isInteger(tick)));
});

scene("a spike of a single sample is drawn", {}, async (page, fake) => {
  await page.getByRole("button", { name: "30 s" }).click();
  await until(page, () => window.eupnea.devices[0].ring.end > 1000);
  fake.devices[0].lung.spike = 24;
  await until(page, () => {
    const canvas = document.querySelector(".strip-pressure .layer");
    const { data } = canvas.getContext("2d").getImageData(0, Math.floor(canvas.height * (1 - 23.5 / 30)), canvas.width, 1);
    return data.some((value, index) => index % 4 === 3 && value > 0);
  });
  // A picture drawn again, decimated over its whole length, still has it.
  await page.setViewportSize({ width: 1300, height: 820 });
  await sleep(500);
  assert.ok(await page.evaluate(() => {
    const canvas = document.querySelector(".strip-pressure .layer");
    const { data } = canvas.getContext("2d").getImageData(0, Math.floor(canvas.height * (1 - 23.5 / 30)), canvas.width, 1);
    return data.some((value, index) => index % 4 === 3 && value > 0);
  }));
});

/** Flashes of the banner in a second, measured over some seconds. */
const flashes = (page, seconds) => page.evaluate((length) => new Promise((resolve) => {
  const banner = document.querySelector("#banner");
  const begin = performance.now();
  let [changes, known] = [0, getComputedStyle(banner).backgroundColor];
  const look = () => {
    const now = getComputedStyle(banner).backgroundColor;
    if (now !== known) changes += 1;
    known = now;
    if (performance.now() - begin < 1000 * length) setTimeout(look, 8);
    else resolve(changes / 2 / ((performance.now() - begin) / 1000));
  };
  look();
}), seconds);

for (const reducedMotion of ["no-preference", "reduce"]) {
  scene(`alarms show priority by colour, mark and text, and flash within their bands (motion: ${reducedMotion})`, { page: { reducedMotion } }, async (page, fake) => {
    assert.match(await text(page, "#banner .banner-text"), /No alarms/);
    fake.alarm(0, "leak", "low", "Leak");
    await until(page, () => document.querySelector("#banner").dataset.priority === "low");
    assert.equal(await flashes(page, 3), 0);
    fake.alarm(0, "rate", "medium", "Rate high");
    await until(page, () => document.querySelector("#banner").dataset.priority === "medium");
    const medium = await flashes(page, 10);
    assert.ok(medium >= 0.4 && medium <= 0.8, `${medium} Hz`);
    fake.alarm(0, "pressure", "high", "Pressure high");
    await until(page, () => document.querySelector("#banner").dataset.priority === "high");
    const high = await flashes(page, 4);
    assert.ok(high >= 1.4 && high <= 2.8, `${high} Hz`);
    assert.equal(await text(page, "#banner .mark"), "!!!");
    assert.equal(await text(page, "#banner .banner-text"), "Pressure high");
    assert.equal(await text(page, "#banner .more"), "+2");
    assert.equal(await text(page, "[role=alert]"), "high priority alarm: Pressure high");
  });
}

scene("the list of alarms is latched, has times, and is acknowledged by who steers", { steer: true }, async (page, fake) => {
  fake.alarm(0, "rate", "medium", "Rate high");
  fake.alarm(0, "pressure", "high", "Pressure high");
  await page.getByRole("tab", { name: "Alarms" }).click();
  await until(page, () => document.querySelectorAll(".alarm").length === 2);
  assert.match(await text(page, ".alarm"), /^!!!Pressure highhigh, present, not acknowledged, since \d\d:\d\d:\d\d$/);
  assert.ok(await page.getByRole("button", { name: "Acknowledge" }).isDisabled());
  fake.devices[0].alarms[1].present = false;
  await until(page, () => document.querySelector("#banner .banner-text").textContent === "Pressure high (gone)");
  assert.equal(await flashes(page, 1), 0);
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await until(page, () => !document.querySelector(".acknowledge").disabled);
  await page.getByRole("button", { name: "Acknowledge" }).click();
  await page.getByRole("tab", { name: "Alarms" }).click();
  await until(page, () => /, acknowledged,/.test(document.querySelector(".alarm").textContent));
});

scene("tones sound, and pause for at most 120 s", {}, async (page, fake) => {
  fake.alarm(0, "pressure", "high", "Pressure high");
  await page.keyboard.press("Shift");
  await until(page, () => Number(document.querySelector(".audio").dataset.bursts) > 0);
  await page.getByRole("button", { name: "Pause 120 s" }).click();
  await until(page, () => /Paused, 1[12]\d s left/.test(document.querySelector(".audio-state").textContent));
  // A page that only reads pauses its own sound, never that of the device.
  assert.equal(fake.received.filter(({ type }) => type === "pause_audio").length, 0);
  const bursts = await page.evaluate(() => document.querySelector(".audio").dataset.bursts);
  await sleep(6_000);
  assert.equal(await page.evaluate(() => document.querySelector(".audio").dataset.bursts), bursts);
  await page.getByRole("button", { name: "End pause" }).click();
  await until(page, (known) => document.querySelector(".audio").dataset.bursts > known, bursts);
});

scene("freeze holds the picture, cursors tell the values, and the data goes on", {}, async (page) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 4000);
  await page.keyboard.press("f");
  const picture = () => page.evaluate(() => document.querySelector(".strip-pressure .layer").toDataURL());
  // The table of values takes a part of the height.
  await sleep(500);
  const [before, tick] = [await picture(), await newest(page)];
  await sleep(700);
  assert.equal(await picture(), before);
  assert.ok((await newest(page)) > tick + 300);
  const cursor = page.getByRole("slider", { name: "Cursor A" });
  await cursor.focus();
  await page.keyboard.press("End");
  assert.match(await cursor.getAttribute("aria-valuetext"), /cmH2O/);
  const time = () => page.locator(".cursor-values tbody td").first().textContent();
  assert.equal(Number(await time()), 0);
  for (let press = 0; press < 3; press++) await page.keyboard.press("ArrowLeft");
  assert.ok(Math.abs(Number(await time()) + 0.03) < 0.0021);
  await page.keyboard.press("f");
  await sleep(300);
  assert.notEqual(await picture(), before);
});

scene("the reference breath is drawn behind later ones and goes again", {}, async (page) => {
  // A complete breath of 3 s, whenever the page began to watch.
  await until(page, () => window.eupnea.devices[0].ring.end > 6500, undefined, 60_000);
  await page.getByRole("button", { name: "Keep reference" }).click();
  assert.ok(await page.evaluate(() => window.eupnea.devices[0].reference.length > 2900));
  await page.getByRole("button", { name: "Forget reference" }).click();
  assert.equal(await page.evaluate(() => window.eupnea.devices[0].reference), null);
});

scene("settings go round: asked, confirmed, applied; by the keyboard alone", { steer: true }, async (page, fake) => {
  await page.keyboard.press("t");
  assert.equal(await page.evaluate(() => document.activeElement.id), "tab-settings");
  await reach(page, "Take control");
  await page.keyboard.press("Enter");
  await until(page, () => !document.querySelector("#setting-pip").disabled);
  assert.match(await text(page, ".who"), /This page steers/);
  await reach(page, "PIP");
  await page.keyboard.press("Control+a");
  await page.keyboard.type("99");
  await page.keyboard.press("Enter");
  assert.match(await text(page, ".steer .result"), /PIP: enter a number from 5 to 50 cmH2O/);
  await page.keyboard.press("Control+a");
  await page.keyboard.type("24.5");
  await page.keyboard.press("Enter");
  await until(page, () => document.querySelector("#setting-pip").closest("tr").querySelector(".applied").textContent === "24.5");
  assert.equal(fake.devices[0].settings.pip, 24.5);
  await page.keyboard.press("Control+a");
  await page.keyboard.type("35");
  await page.keyboard.press("Enter");
  assert.match(await text(page, "dialog"), /PIP from 24.5 to 35 cmH2O/);
  await page.keyboard.press("Escape");
  await until(page, () => document.querySelector("dialog") === null);
  assert.equal(fake.devices[0].settings.pip, 24.5, "Escape changes nothing");
  await page.keyboard.press("Enter");
  await reach(page, "Apply");
  await page.keyboard.press("Enter");
  await until(page, () => document.querySelector("#setting-pip").closest("tr").querySelector(".applied").textContent === "35");
  const applied = fake.received.filter(({ type }) => type === "apply");
  assert.deepEqual(applied.map(({ settings }) => settings.pip), [24.5, 35]);
  assert.equal(applied[1].settings.trigger_flow, 0.6);
});

/** Presses Tab until an element of this name has the focus; each one on the way shows its focus. */
async function reach(page, name, key = "Tab") {
  for (let press = 0; press < 90; press++) {
    await page.keyboard.press(key);
    const focus = await page.evaluate(() => {
      const element = document.activeElement;
      const style = getComputedStyle(element);
      const label = element.labels?.[0]?.textContent ?? element.getAttribute("aria-label") ?? element.textContent;
      return { label, outline: style.outlineStyle !== "none" && Number.parseFloat(style.outlineWidth) >= 2, body: element === document.body };
    });
    if (!focus.body) assert.ok(focus.outline, `the focus on ${focus.label} is not visible`);
    if (focus.label === name) return;
  }
  assert.fail(`Tab does not reach ${name}`);
}

scene("everything is reached by Tab, forwards and backwards", { steer: true, demo: true }, async (page) => {
  await reach(page, "Open R 20 C 20, learned");
  await page.keyboard.press("Enter");
  await until(page, () => document.querySelector(".bedside").hidden === false);
  for (const name of ["Device", "Loops", "Freeze", "12 s", "Keep reference", "Cough", "Keys"]) await reach(page, name);
  await page.keyboard.press("Enter");
  assert.match(await text(page, "dialog"), /Freeze the picture/);
  await page.keyboard.press("Escape");
  await until(page, () => document.querySelector("dialog") === null);
  assert.equal(await page.evaluate(() => document.activeElement.textContent), "Keys", "the focus returns");
  await reach(page, "Wall", "Shift+Tab");
});

scene("start and stop ask for a confirmation", { steer: true }, async (page, fake) => {
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await page.getByRole("button", { name: "Stop ventilation" }).click();
  await page.getByRole("button", { name: "Cancel" }).click();
  assert.equal(fake.devices[0].ventilating, true);
  await page.getByRole("button", { name: "Stop ventilation" }).click();
  await page.locator("dialog .agree").click();
  await page.getByRole("button", { name: "Start ventilation" }).waitFor();
  assert.equal(fake.devices[0].ventilating, false);
});

scene("one page steers; another sees who, and a read-only server offers nothing", { steer: true }, async (page, _fake, url) => {
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  const second = await open(browser, url);
  await second.getByRole("tab", { name: "Settings" }).click();
  await until(second, () => document.querySelector(".who").textContent === "a browser tab steers the device.");
  assert.ok(await second.locator("#setting-pip").isDisabled());
  await second.context().close();
  const reader = new Fake();
  const third = await open(browser, await reader.start());
  await third.getByRole("tab", { name: "Settings" }).click();
  await until(third, () => /read-only/.test(document.querySelector(".who").textContent));
  assert.equal(await third.getByRole("button", { name: "Take control" }).count(), 0);
  await third.context().close();
  await reader.stop();
});

scene("a missing stream is told within a second", {}, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 1000);
  fake.stalled = true;
  await until(page, () => !document.querySelector(".shade").hidden);
  const silence = await page.evaluate(() => performance.now() - window.eupnea.socket.heard);
  assert.ok(silence <= 1100, `${silence} ms`);
  assert.equal(await text(page, ".shade"), "No data");
  assert.match(await text(page, "#banner .banner-text"), /No data from the server/);
  assert.equal(await page.locator("#banner").getAttribute("data-priority"), "high");
  fake.stalled = false;
  await until(page, () => document.querySelector(".shade").hidden);
});

scene("a device that is lost is told, with the reason", {}, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 500);
  fake.devices[0].connected = false;
  fake.states();
  await until(page, () => document.querySelector(".shade").textContent === "Device not connected");
  assert.match(await text(page, "#banner .banner-text"), /the port is gone/);
});

scene("the page finds the server again after its death, and keeps what it had", { steer: true }, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].breath !== null);
  const { port } = fake;
  await fake.stop();
  await until(page, () => /next attempt/.test(document.querySelector(".connection").textContent));
  await sleep(1500);
  await fake.start(port);
  await until(page, () => document.querySelector(".connection").textContent === "Connected" && document.querySelector(".shade").hidden);
  const tick = await newest(page);
  await until(page, (known) => window.eupnea.devices[0].ring.newest > known + 500, tick);
  assert.ok(await page.evaluate(() => window.eupnea.devices[0].trends.newest > 0));
});

scene("the wall shows the worst alarm first, pairs side by side, and opens a device", { demo: true }, async (page, fake) => {
  assert.equal(await page.locator(".card").count(), 9);
  assert.equal(await page.locator(".pair").count(), 3);
  fake.alarm(8, "leak", "low", "Leak");
  fake.alarm(7, "pressure", "high", "Pressure high");
  await until(page, () => document.querySelector(".card .card-name").textContent === "R 20 C 50");
  assert.equal(await text(page, "#banner .banner-text"), "R 20 C 50: Pressure high");
  await page.locator(".card").first().click();
  await until(page, () => document.querySelector(".bedside").hidden === false);
  const watches = () => fake.received.filter(({ type }) => type === "watch").map(({ devices }) => devices.length);
  await until(page, () => window.eupnea.devices.filter(({ watched }) => watched).length === 1);
  assert.deepEqual([watches().at(0), watches().at(-1)], [9, 1]);
  await page.keyboard.press("w");
  await until(page, () => document.querySelector(".wall").hidden === false);
});

scene("the demo's buttons make faults, and mend them", { demo: true }, async (page, fake) => {
  await page.getByRole("button", { name: "Open R 5 C 50, learned" }).click();
  for (const [name, fault] of [["Disconnect", "disconnect"], ["Cough", "cough"], ["Stick the sensor", "stick"], ["Mend all", "none"]]) {
    await page.getByRole("button", { name, exact: true }).click();
    for (let wait = 0; wait < 200 && fake.devices[1].lung.fault !== fault; wait++) await sleep(50);
    assert.equal(fake.devices[1].lung.fault, fault);
  }
});

scene("markers, recording and a triggered capture are asked for and told", { steer: true }, async (page, fake) => {
  await page.getByRole("tab", { name: "Record" }).click();
  await page.locator("#marker-text").fill("lung changed <b>");
  await page.getByRole("button", { name: "Set marker" }).click();
  await until(page, () => document.querySelector(".log li")?.textContent.includes("lung changed <b>"));
  await page.getByRole("button", { name: "Start recording" }).click();
  await until(page, () => /Recording to bench-1.parquet/.test(document.querySelector(".record [role=status]").textContent));
  await page.locator("#capture-overshoot").fill("2,5");
  await page.getByRole("button", { name: "Arm capture" }).click();
  await until(page, () => document.querySelectorAll(".log li").length === 2);
  assert.deepEqual(fake.received.find(({ type }) => type === "capture").triggers, { overshoot: 2.5, pressure: null, alarm: true });
});

scene("the token of the address is sent first and leaves the address bar", {}, async (page, fake, url) => {
  await page.goto("about:blank");
  fake.received.length = 0;
  await page.goto(`${url}#token=secret`);
  await until(page, () => window.eupnea?.devices.length > 0);
  await sleep(200);
  assert.deepEqual(fake.received[0], { type: "token", token: "secret" });
  assert.equal(page.url(), url);
});

scene("a token of an earlier start of the server is forgotten, and the page goes on reading", { token: "new" }, async (page, _fake, url) => {
  await page.goto("about:blank");
  await page.goto(`${url}#token=old`);
  await until(page, () => document.querySelector(".connection")?.textContent === "Read-only: token refused");
  await until(page, () => window.eupnea.devices[0].ring.end > 500);
  assert.equal(await page.evaluate(() => sessionStorage.length), 0);
});
