// What a page is told of the time before it was opened, and what lies on the curves, against the fake server.

import assert from "node:assert/strict";
import { says, scenes, text, until } from "./browser.mjs";

const scene = scenes();

scene("a marker is a line on the curves at its tick, and the flight recorder is read on demand", {}, async (page) => {
  await until(page, () => window.eupnea.devices[0].ring.end > 2000);
  await page.keyboard.press("m");
  await page.locator(".marker").waitFor();
  assert.equal(await text(page, ".marker"), "marker");
  const error = await page.evaluate(() => {
    const { left } = document.querySelector(".marker").getBoundingClientRect();
    const { left: begin, width } = document.querySelector(".strip-pressure .layer").getBoundingClientRect();
    const { tick } = window.eupnea.devices[0].markers[0];
    return Math.abs(left - begin - (((tick / 12_000) % 1) * width));
  });
  assert.ok(error <= 2, `${error} pixels`);
  await page.evaluate(() => { const [device] = window.eupnea.devices; device.takeEvent({ ...device.events[0] }); });
  assert.equal(await page.locator(".marker").count(), 1, "an event that is told again is the same one");
  await page.getByRole("tab", { name: "Record" }).click();
  await page.getByRole("button", { name: "Read the flight recorder" }).click();
  await until(page, () => document.querySelectorAll(".record .log")[1].children.length === 2);
  await says(page, ".record .result", "5000 ticks and 2 events read");
  assert.equal(await page.locator(".record .log").nth(1).locator("li").first().textContent(), "start 3, 9.000 s alarm: leak");
  // Two charts of the last seconds, and two of the last minute; a gap is no line.
  const charts = page.locator(".record .chart canvas");
  assert.equal(await charts.count(), 4);
  for (let chart = 0; chart < 4; chart++) assert.ok((await charts.nth(chart).evaluate(coloured)) > 300, `chart ${chart}`);
  const gap = await page.evaluate(() => window.eupnea.devices[0].recorder.fast.pressure.indexOf(null));
  assert.equal(gap, 1600);
});

/** Counts the pixels of a canvas that have a colour, as curves have and grids have not. */
function coloured(canvas) {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let index = 0; index < data.length; index += 4) {
    const [red, green, blue, alpha] = data.slice(index, index + 4);
    if (alpha > 128 && Math.max(red, green, blue) - Math.min(red, green, blue) > 80) count += 1;
  }
  return count;
}

scene("a page that is loaded again has the trends of the server", {}, async (page, fake) => {
  const newest = Math.floor(Date.now() / 60_000);
  const minutes = Array.from({ length: 240 }, (_, index) => newest - 240 + index);
  const column = minutes.map(() => 17);
  fake.devices[0].history = { minutes, breaths: minutes.map(() => 20), figures: { pip: { low: column, mean: column, high: column } } };
  await page.reload();
  await until(page, () => window.eupnea?.devices[0]?.trends.series("pip", 8).mean.filter((value) => value === 17).length >= 200);
});

scene("the verdict on a recording has a panel of its own", {}, async (page, fake) => {
  assert.ok(await page.getByRole("tab", { name: "Verdict" }).isHidden());
  const limit = { name: "overshoot", unit: "cmH2O", limit: { fixed: 2, percent: 0 }, checked: 40, violations: 10, worst: 6.25, worst_breath: 7 };
  fake.devices[0].verdict = { refused: null, breaths: 40, unjudged: 2, violating: 10, error: 1.234, explored: 0, inspiration: { fixed: 1.1, percent: 2 }, expiration: null, limits: [limit], sore_spots: ["R20C20: overshoot"] };
  await page.reload();
  await page.getByRole("tab", { name: "Verdict" }).click();
  assert.equal(await text(page, ".verdict-share"), "10 of 40 judged breaths (25 %) violate a limit.");
  assert.equal(await text(page, ".limits tbody tr"), "overshoot2 cmH2O10 of 4025 %6.3breath 7");
});
