// The page in a real browser, against the fake server.

import assert from "node:assert/strict";
import { Fake } from "../dev/fake.mjs";
import { drawn, eventually, flashes, open, painted, pass, says, scenes, silence, steady, text, until, updated } from "./browser.mjs";

const scene = scenes();

/** Options of a scene that must not see a silence which the machine makes. */
const HELD = { page: { held: true } };
const newest = (page) => page.evaluate(() => window.eupnea.devices[0].ring.newest);

scene("waveforms are there, as pixels and as data, and no sample is missing", {}, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 4000);
  for (const strip of ["pressure", "flow", "volume", "valves", "learned"]) assert.ok((await painted(page, strip)) > 500, strip);
  await eventually(async () => fake.devices[0].lung.tick - (await newest(page)) < 1000, "the page shows the newest second");
  const { missing: lost, malformed } = await page.evaluate(() => ({ missing: window.eupnea.devices[0].ring.missing, malformed: window.eupnea.socket.malformed }));
  assert.deepEqual([lost, malformed], [0, 0]);
  await until(page, () => document.querySelector(".tile.large .value").textContent !== "--");
  assert.match(await text(page, ".tile.large .value"), /^20\.\d$/);
  await eventually(() => fake.drawn.length > 5, "the page tells what it has drawn");
  assert.ok(fake.drawn.every(({ device, tick }) => device === 0 && Number.isInteger(tick)));
});

scene("with a flow sensor nothing is marked as estimated, and the leak and the adaptation are shown", {}, async (page, fake) => {
  const tile = (name) => page.locator(".tile").filter({ has: page.getByText(name, { exact: true }) }).locator("dd").textContent();
  const marks = () => page.locator(".estimated").filter({ visible: true }).count();
  const label = () => page.locator(".strip-flow").getAttribute("aria-label");
  await eventually(async () => (await tile("Leak")).includes("no flow sensor"), "without a sensor a leak is unknown");
  assert.match(await tile("Leak"), /^--/);
  await eventually(async () => (await marks()) >= 6 && (await label()) === "Flow, estimated", "flow, volume, two volumes and the lung are marked");
  await eventually(async () => /^learning, 2 of 4 breaths.*last breath: adopted$/.test(await tile("Adaptation")), "the adaptation is told");
  fake.devices[0].lung.measured = true;
  fake.devices[0].adaptation = { breaths: 4, of: 4, last: "discarded" };
  await eventually(async () => (await tile("Leak")).startsWith("4.2L/min"), "the leak is known");
  await eventually(async () => (await marks()) === 0 && (await label()) === "Flow", "nothing is estimated");
  await eventually(async () => /^adapted.*last breath: discarded$/.test(await tile("Adaptation")), "it has adapted");
  fake.devices[0].adaptation = null;
  await eventually(async () => (await tile("Adaptation")) === "--", "a PID does not adapt");
});

scene("a spike of a single sample is drawn", {}, async (page, fake) => {
  const spike = () => {
    const canvas = document.querySelector(".strip-pressure .layer");
    const { data } = canvas.getContext("2d").getImageData(0, Math.floor(canvas.height * (1 - 23.5 / 30)), canvas.width, 1);
    return data.some((value, index) => index % 4 === 3 && value > 0);
  };
  await page.getByRole("button", { name: "30 s" }).click();
  await until(page, () => window.eupnea.devices[0].ring.end > 1000);
  fake.devices[0].lung.spike = 24;
  await until(page, spike);
  // A picture drawn again, decimated over its whole length, still has it.
  const width = () => page.evaluate(() => document.querySelector(".strip-pressure .layer").width);
  const before = await width();
  await page.setViewportSize({ width: 1300, height: 820 });
  await until(page, (known) => document.querySelector(".strip-pressure .layer").width !== known, before);
  await until(page, spike);
});

scene("alarms show priority by colour, mark and text, and flash within their bands, whatever motion is preferred", HELD, async (page, fake) => {
  const shows = (priority) => until(page, (wanted) => document.querySelector("#banner").dataset.priority === wanted, priority);
  await says(page, "#banner .banner-text", "No alarms");
  fake.alarm(0, "leak", "low", "Leak");
  await shows("low");
  assert.ok(await steady(page), "low does not flash");
  fake.alarm(0, "rate", "medium", "Rate high");
  await shows("medium");
  const medium = await flashes(page, 2);
  assert.ok(medium >= 0.4 && medium <= 0.8, `${medium} Hz`);
  fake.alarm(0, "pressure", "high", "Pressure high");
  await shows("high");
  for (const reducedMotion of ["no-preference", "reduce"]) {
    await page.emulateMedia({ reducedMotion });
    const high = await flashes(page, 4);
    assert.ok(high >= 1.4 && high <= 2.8, `${high} Hz`);
  }
  assert.equal(await text(page, "#banner .mark"), "!!!");
  assert.equal(await text(page, "#banner .banner-text"), "Pressure high");
  assert.equal(await text(page, "#banner .more"), "+2");
  assert.equal(await text(page, "[role=alert]"), "high priority alarm: Pressure high");
});

scene("the list of alarms is latched, has times, and is acknowledged by who steers", { ...HELD, steer: true }, async (page, fake) => {
  fake.alarm(0, "rate", "medium", "Rate high");
  fake.alarm(0, "pressure", "high", "Pressure high");
  await page.getByRole("tab", { name: "Alarms" }).click();
  await until(page, () => document.querySelectorAll(".alarm").length === 2);
  assert.match(await text(page, ".alarm"), /^!!!Pressure highhigh, present, not acknowledged, since \d\d:\d\d:\d\d$/);
  assert.ok(await page.getByRole("button", { name: "Acknowledge" }).isDisabled());
  fake.devices[0].alarms[1].present = false;
  await says(page, "#banner .banner-text", "Pressure high (gone)");
  // A present alarm is not hidden.
  await says(page, "#banner .behind", "Present: !! Rate high");
  const latched = await flashes(page, 4);
  assert.ok(latched >= 1.4 && latched <= 2.8, `a latched alarm flashes: ${latched} Hz`);
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await until(page, () => !document.querySelector(".acknowledge").disabled);
  await page.getByRole("button", { name: "Acknowledge" }).click();
  await page.getByRole("tab", { name: "Alarms" }).click();
  await says(page, ".alarm", /, acknowledged,/);
  // The alarm whose condition was gone is removed; the present one is marked, and flashes until its condition is gone, too.
  await says(page, "#banner .banner-text", "Rate high (acknowledged)");
  assert.equal(await text(page, "[role=alert]"), "medium priority alarm: Rate high, acknowledged");
  const known = await flashes(page, 2);
  assert.ok(known >= 0.4 && known <= 0.8, `an acknowledged alarm flashes while it is present: ${known} Hz`);
  fake.devices[0].alarms[0].present = false;
  await says(page, "#banner .banner-text", "No alarms");
});

scene("tones sound, and pause for at most 120 s", HELD, async (page, fake) => {
  fake.alarm(0, "pressure", "high", "Pressure high");
  await page.keyboard.press("Shift");
  await until(page, () => Number(document.querySelector(".audio").dataset.bursts) > 0);
  await page.getByRole("button", { name: "Pause 120 s" }).click();
  await says(page, ".audio-state", /Paused, 1[12]\d s left/);
  // A page that only reads pauses its own sound, never that of the device.
  assert.equal(fake.received.filter(({ type }) => type === "pause_audio").length, 0);
  const bursts = await sounded(page);
  // Without the pause the next burst would come 7.5 s after the last one: by the clock of the sound, which is not that of the page.
  const sound = () => page.evaluate(() => window.eupnea.audio.sound.context.currentTime);
  const begin = await sound();
  const left = async () => Number(/Paused, (\d+) s left/.exec(await text(page, ".audio-state"))?.[1]);
  // Each update needs another state, so that the page does not find the device silent.
  for (; (await left()) >= 112; await updated(page)) await pass(page, 500);
  await eventually(async () => (await sound()) > begin + 8, "the next burst would be due");
  await updated(page);
  await stillPaused(page, "it lasts longer than the time between two bursts");
  assert.equal(await sounded(page), bursts);
  await page.getByRole("button", { name: "End pause" }).click();
  await until(page, (known) => Number(document.querySelector(".audio").dataset.bursts) > known, bursts);
});

const sounded = (page) => page.evaluate(() => Number(document.querySelector(".audio").dataset.bursts));
const stillPaused = async (page, why) => assert.equal(await page.locator(".audio").getAttribute("data-paused"), "true", why);
const pauses = (page, on) => until(page, (wanted) => document.querySelector(".audio").dataset.paused === String(wanted), on);

scene("a pause on the wall holds for all devices, until a new high alarm of any of them", { ...HELD, demo: true }, async (page, fake) => {
  await page.keyboard.press("Shift");
  fake.alarm(1, "rate", "medium", "Rate high");
  fake.alarm(2, "high-pressure", "high", "Pressure high");
  // Both alarms are known before the pause: the second one would end it.
  await until(page, () => document.querySelectorAll('.card .banner:not([data-priority="none"])').length === 2);
  await until(page, () => Number(document.querySelector(".audio").dataset.bursts) > 0);
  await page.keyboard.press("p");
  await pauses(page, true);
  fake.alarm(3, "leak", "medium", "Leak");
  await until(page, () => document.querySelectorAll('.card .banner:not([data-priority="none"])').length === 3);
  await drawn(page);
  await stillPaused(page, "a medium alarm does not end it");
  const bursts = await sounded(page);
  // While one device is shown, the pause of the others goes on.
  await page.getByRole("button", { name: "Open R 5 C 50, PID" }).click();
  await drawn(page);
  await stillPaused(page, "opening a device does not end it");
  fake.alarm(4, "disconnection", "high", "Patient disconnected");
  await pauses(page, false);
  await until(page, (known) => Number(document.querySelector(".audio").dataset.bursts) > known, bursts);
});

scene("a page that steers pauses the device's sounder, and tells a refusal", { ...HELD, steer: true }, async (page, fake) => {
  fake.alarm(0, "high-pressure", "high", "Pressure high");
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await until(page, () => window.eupnea.devices[0].yours);
  fake.devices[0].pausing = false;
  await page.getByRole("button", { name: "Pause 120 s" }).click();
  await says(page, ".audio-state", "Pause refused: no sounder");
  await page.getByRole("button", { name: "End pause" }).click();
  fake.devices[0].pausing = true;
  // The page is watched from before the click on, because the rest of the pause runs down on the machine's clock.
  const paused = until(page, () => window.eupnea.devices[0].state.audio.pause_left > 100);
  await Promise.all([paused, page.getByRole("button", { name: "Pause 120 s" }).click()]);
  assert.deepEqual(fake.received.filter(({ type }) => type === "pause_audio").map(({ seconds }) => seconds), [120, 0, 120]);
});

scene("freeze holds the picture, cursors tell the values, and the data goes on", {}, async (page) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 4000);
  await page.keyboard.press("f");
  const picture = () => page.evaluate(() => document.querySelector(".strip-pressure .layer").toDataURL());
  // The table of values takes a part of the height: the picture is drawn again, and then it holds.
  let before = "";
  await eventually(async () => {
    const known = before;
    await drawn(page);
    before = await picture();
    return before === known;
  }, "the picture holds");
  await until(page, (known) => window.eupnea.devices[0].ring.newest > known + 500, await newest(page));
  await drawn(page);
  assert.equal(await picture(), before);
  const cursor = page.getByRole("slider", { name: "Cursor A" });
  await cursor.focus();
  await page.keyboard.press("End");
  assert.match(await cursor.getAttribute("aria-valuetext"), /cmH2O/);
  const time = () => page.locator(".cursor-values tbody td").first().textContent();
  assert.equal(Number(await time()), 0);
  for (let press = 0; press < 3; press++) await page.keyboard.press("ArrowLeft");
  assert.ok(Math.abs(Number(await time()) + 0.03) < 0.0021);
  await page.keyboard.press("f");
  await eventually(async () => (await picture()) !== before, "the picture goes on");
});

scene("a frozen picture says so, does not hide that nothing arrives, and runs again when its view is left", { demo: true }, async (page, fake) => {
  await page.getByRole("button", { name: "Open R 20 C 50" }).click();
  await page.keyboard.press("f");
  await says(page, ".held", /^FROZEN \d\d:\d\d:\d\d$/);
  fake.devices[7].connected = false;
  await says(page, ".held", /^FROZEN \d\d:\d\d:\d\d\. Now: Device not connected$/);
  fake.devices[7].connected = true;
  fake.stalled = true;
  await says(page, ".held", /^FROZEN \d\d:\d\d:\d\d\. Now: No data$/);
  fake.stalled = false;
  await says(page, ".held", /^FROZEN \d\d:\d\d:\d\d$/);
  await page.keyboard.press("w");
  await page.getByRole("button", { name: "Open R 20 C 50" }).click();
  assert.equal(await text(page, ".held"), "");
  assert.equal(await page.evaluate(() => window.eupnea.bedside.waves.isFrozen), false);
  assert.equal(await text(page, ".freeze"), "Freeze");
});

scene("on the wall, keys do not act on the device that was shown last", { demo: true }, async (page, fake) => {
  await page.getByRole("button", { name: "Open R 20 C 50" }).click();
  await until(page, () => window.eupnea.devices[7].breath !== null && window.eupnea.devices[7].ring.end > 6500);
  const pressed = () => page.evaluate(() => [...document.querySelectorAll(".sweeps [aria-pressed=true]")].map(({ textContent }) => textContent).join());
  await page.keyboard.press("w");
  await page.locator(".wall").waitFor();
  for (const key of ["m", "f", "s", "r", "a", "t"]) await page.keyboard.press(key);
  // What comes after a marker has come after it at the server, too.
  await page.getByRole("button", { name: "Open R 20 C 50" }).click();
  await eventually(() => fake.received.at(-1).type === "watch" && fake.received.at(-1).devices.length === 1, "the device is shown again");
  assert.deepEqual(fake.received.filter(({ type }) => type === "mark"), []);
  assert.equal(await text(page, ".held"), "");
  assert.equal(await pressed(), "12 s");
  assert.equal(await page.evaluate(() => window.eupnea.devices[7].reference), null);
  assert.equal(await page.getByRole("tab", { name: "Loops" }).getAttribute("aria-selected"), "true");
});

scene("the reference breath is drawn behind later ones and goes again", {}, async (page) => {
  // A complete breath of 3 s, whenever the page began to watch.
  await until(page, () => window.eupnea.devices[0].ring.end > 6500);
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
  await says(page, ".steer .result", "Applied from the next breath on.");
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
  assert.deepEqual(applied.map(({ settings }) => settings), [{ pip: 24.5 }, { pip: 35 }], "only what was edited is sent");
});

scene("fields that are not edited follow the device, those that are stay, and without settings the form is off", { steer: true }, async (page, fake) => {
  const { settings } = fake.devices[0];
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await until(page, () => !document.querySelector("#setting-pip").disabled);
  await page.locator("#setting-pip").fill("22");
  fake.devices[0].settings = { ...settings, rate: 15, pip: 18 };
  await until(page, () => document.querySelector("#setting-rate").value === "15");
  assert.equal(await page.locator("#setting-pip").inputValue(), "22");
  await page.locator("#setting-pip").press("Enter");
  await eventually(() => fake.devices[0].settings.pip === 22, "the change is applied");
  assert.equal(fake.devices[0].settings.rate, 15, "a change from elsewhere stays");
  fake.devices[0].untold = true;
  await until(page, () => document.querySelector("#setting-pip").disabled && document.querySelector(".apply").disabled);
  assert.equal(await page.locator("#setting-pip").inputValue(), "");
  assert.ok(await page.getByRole("button", { name: "Stop ventilation" }).isEnabled(), "ventilation can be stopped all the same");
  fake.devices[0].untold = false;
  await until(page, () => !document.querySelector("#setting-pip").disabled && document.querySelector("#setting-pip").value === "22");
});

scene("an acknowledgement that leaves the safe state says so and asks", { steer: true }, async (page, fake) => {
  const [device] = fake.devices;
  fake.alarm(0, "high-pressure", "high", "Pressure high");
  Object.assign(device, { mode: "vented: high pressure", safeState: true, ventilating: false });
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  const leave = page.locator(".acknowledge");
  await until(page, () => document.querySelector(".acknowledge").textContent === "Acknowledge, leave safe state" && !document.querySelector(".acknowledge").disabled);
  await leave.click();
  await page.getByRole("button", { name: "Cancel" }).click();
  assert.equal(device.alarms[0].acknowledged, false);
  await leave.click();
  await page.locator("dialog .agree").click();
  await eventually(() => device.alarms[0].acknowledged, "the alarm is acknowledged");
});

/** What a page shows that knows nothing of any patient. */
async function knowsNothing(page) {
  await until(page, () => document.querySelector("#banner").dataset.priority === "high");
  assert.equal(await text(page, "#banner .banner-text"), "No data from the server");
  assert.equal(await page.locator(".connection").getAttribute("data-ok"), "false");
}

scene("a page that the server does not serve, without its token or with a wrong one, is neither connected nor without alarms", { token: "new", listen: true }, async (page, _fake, url) => {
  assert.equal(await text(page, "#banner .banner-text").then((shown) => /No alarms/.test(shown)), false);
  await knowsNothing(page);
  await says(page, ".connection", /^No answer. If the server needs a token/);
  await page.keyboard.press("Shift");
  await says(page, ".audio-state", "Sounding: high priority");
  await page.goto("about:blank");
  await page.goto(`${url}#token=old`);
  await until(page, () => /^Token refused: open the address/.test(document.querySelector(".connection")?.textContent));
  await knowsNothing(page);
  await page.goto("about:blank");
  await page.goto(`${url}#token=new`);
  await until(page, () => document.querySelector(".connection")?.textContent === "Connected");
  await says(page, "#banner .banner-text", "No alarms");
});

scene("there are no alarms only once the state of the device is known", {}, async (page, fake) => {
  fake.devices[0].state = () => ({ type: "steerer", device: 0, who: null, yours: false });
  await page.reload();
  await until(page, () => window.eupnea?.devices.length > 0);
  assert.notEqual(await text(page, "#banner .banner-text"), "No alarms");
  await until(page, () => document.querySelector("#banner").dataset.priority === "high");
  delete fake.devices[0].state;
  await says(page, "#banner .banner-text", "No alarms");
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

scene("start and stop ask for a confirmation", { ...HELD, steer: true }, async (page, fake) => {
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await page.getByRole("button", { name: "Stop ventilation" }).click();
  await page.getByRole("button", { name: "Cancel" }).click();
  assert.equal(fake.devices[0].ventilating, true);
  await page.getByRole("button", { name: "Stop ventilation" }).click();
  await page.locator("dialog .agree").click();
  await page.getByRole("button", { name: "Start ventilation" }).waitFor();
  assert.equal(fake.devices[0].ventilating, false);
  // A start that waits for the device can be cancelled.
  fake.devices[0].testing = true;
  await page.getByRole("button", { name: "Start ventilation" }).click();
  await page.locator("dialog .agree").click();
  await eventually(() => fake.received.at(-1).type === "start", "the start is asked for");
  await page.getByRole("button", { name: "Cancel the start" }).click();
  await page.getByRole("button", { name: "Start ventilation" }).waitFor();
  await eventually(() => fake.received.at(-1).type === "stop", "the start is taken back");
});

scene("one page steers; another sees who, and a read-only server offers nothing", { steer: true }, async (page, _fake, url) => {
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  const second = await open(page.context().browser(), url);
  await second.getByRole("tab", { name: "Settings" }).click();
  await says(second, ".who", "a browser tab steers the device.");
  assert.ok(await second.locator("#setting-pip").isDisabled());
  await second.getByRole("button", { name: "Take over control" }).click();
  await second.getByRole("button", { name: "Cancel" }).click();
  assert.equal(await page.evaluate(() => window.eupnea.devices[0].yours), true);
  await second.getByRole("button", { name: "Take over control" }).click();
  assert.match(await text(second, "dialog"), /a browser tab steers Bench now and will lose control/);
  await second.locator("dialog .agree").click();
  await until(second, () => window.eupnea.devices[0].yours);
  await until(page, () => !window.eupnea.devices[0].yours);
  await second.context().close();
  const reader = new Fake();
  const third = await open(page.context().browser(), await reader.start());
  await third.getByRole("tab", { name: "Settings" }).click();
  await says(third, ".who", /read-only/);
  assert.equal(await third.getByRole("button", { name: "Take control" }).count(), 0);
  await third.context().close();
  await reader.stop();
});

scene("a missing stream is told within a second", {}, async (page, fake) => {
  const told = await silence(page, (stalled) => { fake.stalled = stalled; });
  assert.ok(told <= 1000, `${told} ms`);
  await says(page, ".shade", "No data");
  await says(page, "#banner .banner-text", /No data from the server/);
  assert.equal(await page.locator("#banner").getAttribute("data-priority"), "high");
  fake.stalled = false;
  await until(page, () => document.querySelector(".shade").hidden);
});

scene("a half-open connection is given up and opened again, although the browser does not notice", HELD, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 500);
  let connections = 0;
  fake.sockets.on("connection", () => { connections += 1; });
  fake.unplug();
  await pass(page, 1000);
  await until(page, () => document.querySelector(".connection").textContent === "No data" && document.querySelector(".connection").dataset.ok === "false");
  assert.equal(connections, 0, "a short silence opens nothing");
  await page.evaluate(() => { window.dead = window.eupnea.socket.socket; });
  const waits = () => page.evaluate(() => [null, window.dead].includes(window.eupnea.socket.socket));
  for (let passed = 1000; passed < 10_000 && (await waits()); passed += 500) await pass(page, 500);
  await until(page, () => document.querySelector(".connection").textContent === "Connected" && document.querySelector(".shade").hidden);
  assert.equal(connections, 1);
  const tick = await newest(page);
  await until(page, (known) => window.eupnea.devices[0].ring.newest > known + 500, tick);
});

scene("a page without timers and pictures of its own, as a hidden one, tells it all the same", {}, async (page, fake) => {
  await page.addInitScript(() => {
    window.setInterval = () => 0;
    window.requestAnimationFrame = () => 0;
  });
  await page.reload();
  await until(page, () => window.eupnea?.devices[0]?.ring.end > 500);
  fake.stalled = true;
  // Samples can be found missing a moment before the states.
  await says(page, "#banner .banner-text", "No data from the server");
  assert.equal(await page.locator("#banner").getAttribute("data-priority"), "high");
});

scene("samples that are missing are told, although states arrive", {}, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 500);
  fake.devices[0].mute = true;
  await says(page, "#banner .banner-text", "No samples from the device");
  assert.equal(await page.locator("#banner").getAttribute("data-priority"), "high");
  await until(page, () => !document.querySelector(".shade").hidden);
  fake.devices[0].mute = false;
  await until(page, () => document.querySelector(".shade").hidden);
});

scene("a replay and a simulation do not look like a live device", { demo: true }, async (page, fake) => {
  await says(page, ".card .origin", "SIMULATED");
  fake.devices[0].kind = "recording";
  await page.reload();
  await until(page, () => document.querySelector(".card .origin")?.textContent === "REPLAY");
  await says(page, ".card .banner-text", "Replay: alarms are not evaluated");
  await page.locator(".card").first().click();
  await says(page, ".waves .origin", "REPLAY");
  await says(page, "#banner .banner-text", "Replay: alarms are not evaluated");
});

scene("a device that is lost is told, with the reason", {}, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 500);
  fake.devices[0].connected = false;
  fake.states();
  await says(page, ".shade", "Device not connected");
  await says(page, "#banner .banner-text", /the port is gone/);
});

scene("on the wall, a device that is lost or silent looks it, and figures of before a stop look old", { ...HELD, demo: true, steer: true }, async (page, fake) => {
  const card = (name) => page.locator(".card").filter({ has: page.getByText(name, { exact: true }) });
  const has = async (name, look) => (await card(name).getAttribute("class")).split(" ").includes(look);
  await until(page, () => window.eupnea.devices.every(({ breath }) => breath !== null));
  const [live, lost, silent, stopped] = [3, 4, 5, 6].map((index) => fake.devices[index]);
  await eventually(async () => (await page.locator(".card.stale, .card.old").count()) === 0, "all cards look live");
  lost.connected = false;
  silent.mute = true;
  stopped.ventilating = false;
  await eventually(async () => (await has(lost.name, "stale")) && (await has(silent.name, "stale")) && (await has(stopped.name, "old")), "they look stale");
  assert.equal(await card(lost.name).locator(".card-cover").textContent(), "Device not connected");
  assert.equal(await card(silent.name).locator(".card-cover").textContent(), "No data");
  assert.equal(await card(stopped.name).locator(".card-cover").isVisible(), false);
  await eventually(async () => !(await has(live.name, "stale")) && !(await has(live.name, "old")), "another one looks live");
  const colours = await Promise.all([live, lost, stopped].map(({ name }) => card(name).locator("dd").first().evaluate((element) => getComputedStyle(element).color)));
  assert.ok(colours[0] !== colours[1] && colours[1] === colours[2], colours.join());
  await page.getByRole("button", { name: `Open ${stopped.name}`, exact: true }).click();
  await says(page, ".age", /^Last breath at \d\d:\d\d:\d\d$/);
  stopped.ventilating = true;
  await says(page, ".age", "");
});

scene("the page finds the server again after its death, and keeps what it had", { steer: true }, async (page, fake) => {
  await until(page, () => window.eupnea.devices[0].breath !== null);
  const { port } = fake;
  await fake.stop();
  await says(page, ".connection", /next attempt/);
  // More than one attempt fails.
  await until(page, () => window.eupnea.socket.attempts > 1);
  await fake.start(port);
  await until(page, () => document.querySelector(".connection").textContent === "Connected" && document.querySelector(".shade").hidden);
  const tick = await newest(page);
  await until(page, (known) => window.eupnea.devices[0].ring.newest > known + 500, tick);
  assert.ok(await page.evaluate(() => window.eupnea.devices[0].trends.newest > 0));
});

scene("a card that is pressed stays under the pointer while an alarm moves another one to the front", { ...HELD, demo: true }, async (page, fake) => {
  const names = () => page.evaluate(() => [...document.querySelectorAll(".card")].map((card) => card.ariaLabel));
  await page.locator(".wall").waitFor();
  const [first] = await names();
  const box = await page.locator(".card-open").first().boundingBox();
  await page.mouse.move(box.x + 5, box.y + 5);
  await page.mouse.down();
  fake.alarm(4, "disconnection", "high", "Patient disconnected");
  await until(page, () => document.querySelector('.card .banner[data-priority="high"]') !== null);
  await drawn(page);
  assert.equal((await names())[0], first, "the cards stay");
  await page.mouse.up();
  await until(page, () => document.querySelector(".wall").hidden);
  assert.equal(await page.locator("#device option:checked").textContent(), first);
});

scene("the wall shows the worst alarm first, pairs side by side, and opens a device", { demo: true }, async (page, fake) => {
  await until(page, () => document.querySelectorAll(".card").length === 9 && document.querySelectorAll(".pair").length === 3);
  fake.alarm(8, "leak", "low", "Leak");
  fake.alarm(7, "pressure", "high", "Pressure high");
  await says(page, ".card .card-name", "R 20 C 50");
  await says(page, "#banner .banner-text", "R 20 C 50: Pressure high");
  await page.locator(".card").first().click();
  await until(page, () => document.querySelector(".bedside").hidden === false);
  const watches = () => fake.received.filter(({ type }) => type === "watch").map(({ devices }) => devices.length);
  await eventually(() => watches().at(0) === 9 && watches().at(-1) === 1, "only the samples of what is shown are asked for");
  await page.keyboard.press("w");
  await until(page, () => document.querySelector(".wall").hidden === false);
});

scene("the demo's buttons make faults, and clear them", { demo: true }, async (page, fake) => {
  await page.getByRole("button", { name: "Open R 5 C 50, learned" }).click();
  for (const [name, fault] of [["Disconnect", "disconnect"], ["Cough", "cough"], ["Stick the sensor", "stick"], ["Clear faults", "none"]]) {
    await page.getByRole("button", { name, exact: true }).click();
    await eventually(() => fake.devices[1].lung.fault === fault, `${name} makes the fault ${fault}`);
  }
});

scene("markers, recording and a triggered capture are asked for and told", { steer: true }, async (page, fake) => {
  await page.getByRole("tab", { name: "Record" }).click();
  await page.locator("#marker-text").fill("lung changed <b>");
  await page.getByRole("button", { name: "Set marker" }).click();
  await until(page, () => document.querySelector(".log li")?.textContent.includes("lung changed <b>"));
  await page.getByRole("button", { name: "Start recording" }).click();
  await says(page, ".record [role=status]", /Recording to bench-1.parquet/);
  assert.doesNotMatch(await text(page, ".record [role=status]"), /lost/);
  fake.devices[0].recording.lost = 1234;
  await says(page, ".record [role=status]", /, 1 234 samples lost: the disk is too slow/);
  await says(page, ".armed", "Not armed.");
  for (const [wrong, reason] of [["", /choose a trigger/], ["2x", /enter a number above 0/], ["-1", /enter a number above 0/]]) {
    await page.locator("#capture-overshoot").fill(wrong);
    await page.getByRole("button", { name: "Arm capture" }).click();
    assert.match(await text(page, ".record .result"), reason);
  }
  await page.locator("#capture-overshoot").fill("2,5");
  await page.locator("#capture-alarm").check();
  await page.getByRole("button", { name: "Arm capture" }).click();
  await says(page, ".armed", "Armed: overshoot above 2.5 cmH2O, an alarm.");
  await page.getByRole("button", { name: "Disarm" }).click();
  await says(page, ".armed", "Not armed.");
  const captures = fake.received.filter(({ type }) => type === "capture").map(({ triggers }) => triggers);
  assert.deepEqual(captures, [{ overshoot: 2.5, pressure: null, alarm: true }, {}]);
});

scene("without steering, a page records if the server lets it, and is told if not", { record: false }, async (page, fake) => {
  await page.getByRole("tab", { name: "Record" }).click();
  const controls = () => page.locator(".record button").filter({ visible: true }).count();
  const told = () => page.getByText("This page is read-only: start the server with --steer to record.").isVisible();
  await eventually(async () => (await controls()) === 0 && (await told()), "the page is read-only");
  fake.record = true;
  await page.reload();
  await page.getByRole("tab", { name: "Record" }).click();
  await eventually(async () => (await controls()) === 5 && !(await told()), "the page may record");
  await page.getByRole("button", { name: "Start recording" }).click();
  await says(page, ".record [role=status]", /Recording to bench-1.parquet/);
});

scene("the token of the address is sent first and leaves the address bar", {}, async (page, fake, url) => {
  await page.goto("about:blank");
  fake.received.length = 0;
  await page.goto(`${url}#token=secret`);
  await until(page, () => window.eupnea?.devices.length > 0);
  await eventually(() => fake.received.length > 0, "the page sends something");
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
