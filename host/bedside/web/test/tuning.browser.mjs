// The measurement of margins and its result, in a real browser, against the fake server.

import assert from "node:assert/strict";
import { refused, result } from "../dev/margins.mjs";
import { eventually, known, says, scenes, text, until } from "./browser.mjs";

const scene = scenes({ held: true });

/** Takes control of the device, and opens the tab with its margins. */
async function tune(page) {
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await page.getByRole("tab", { name: "Tuning" }).click();
}

const measure = (page) => page.getByRole("button", { name: "Measure margins" });

scene("margins are measured only after a test lung is confirmed, with progress, and stop", { steer: true }, async (page, fake) => {
  const asked = () => fake.received.filter(({ type }) => type === "measure");
  await page.getByRole("tab", { name: "Tuning" }).click();
  assert.ok(await measure(page).isDisabled(), "this page does not steer");
  assert.match(await text(page, ".tuning > .quiet"), /take control of the device first/);
  await tune(page);
  await measure(page).click();
  assert.match(await text(page, "dialog"), /Is a test lung connected\?.*Never measure with a patient.*sines of 10 %.*126 breaths, about 6 minutes/);
  assert.equal(await page.evaluate(() => document.activeElement.className), "cancel");
  await page.keyboard.press("Enter");
  assert.equal(asked().length, 0, "nothing is measured without a confirmation");
  await page.getByLabel("Amplitude").fill("30");
  await measure(page).click();
  await says(page, ".tuning .result", "Amplitude: enter a number from 0.1 to 20.");
  await page.getByLabel("Amplitude").fill("8");
  await measure(page).click();
  await page.locator("dialog .agree").click();
  await eventually(() => asked().length === 1, "the measurement is asked for");
  const [{ test_lung, sines }] = asked();
  assert.deepEqual([test_lung, sines], [true, { amplitude: 8, frequencies: 20, breaths: 6 }]);
  await says(page, ".tuning > [role=status]", /^Measuring: breath 6 of 126, about 6 minutes left\.$/);
  fake.devices[0].measuring.breath = 60;
  await says(page, ".tuning > [role=status]", /breath 60 of 126, about 3 minutes/);
  assert.equal(await page.evaluate(() => document.querySelector(".tuning progress").value), 60);
  assert.ok(await measure(page).isDisabled());
  await page.getByRole("button", { name: "Stop measuring" }).click();
  await eventually(() => fake.received.some(({ type }) => type === "stop_measuring"), "it is stopped");
  await eventually(() => measure(page).isEnabled(), "it can be measured again");
});

scene("the margins are shown with how sure they are, advice and figures, to every page", {}, async (page, fake) => {
  await page.getByRole("tab", { name: "Tuning" }).click();
  await says(page, ".tuning > [role=status]", "The margins of this device are not measured yet.");
  assert.ok(await measure(page).isHidden(), "this server lets no page steer");
  fake.measured(0, result());
  const row = (name) => page.locator(".margins .limits tr").filter({ hasText: new RegExp(`^${name}`) }).textContent();
  await eventually(async () => (await page.locator(".margins .limits tbody tr").count()) === 3, "the margins come");
  assert.equal(await row("Ms"), "Ms2.342.21 to 2.50at most 2not kept");
  assert.equal(await row("Gain margin"), "Gain margin2.512.41 to 2.59at least 2kept");
  assert.equal(await row("Delay margin"), "Delay marginmsnot enough coherencefrom 31.2at least 10");
  assert.match(await text(page, ".margins .advice"), /^Gain The gain is too high: Ms is 2\.34 at 7\.1 Hz/);
  await until(page, () => document.querySelectorAll(".margins .chart .uplot").length === 5);
  await until(page, () => {
    const canvas = document.querySelector(".margins .layer");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return data.filter((value, index) => index % 4 === 3 && value > 0).length > 500;
  });
  fake.measured(0, refused("an alarm ended the measurement: Disconnection"));
  await says(page, ".margins .no-margins", "No margins: an alarm ended the measurement: Disconnection.");
  assert.equal(await page.locator(".margins .chart").count(), 0);
});

scene("a page that opens later has the margins, and a replay has no tab for them", {}, async (page, fake) => {
  fake.devices[0].margins = result();
  await page.reload();
  await page.getByRole("tab", { name: "Tuning" }).click();
  await eventually(async () => (await page.locator(".margins .limits tbody tr").count()) === 3, "the margins are there");
  fake.devices[0].kind = "recording";
  await page.reload();
  await known(page);
  await eventually(() => page.getByRole("tab", { name: "Tuning" }).isHidden(), "a replay cannot be measured");
});
