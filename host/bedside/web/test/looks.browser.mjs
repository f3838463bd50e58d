// How the page looks on three screens: nothing beside the edge, no violation found by axe-core (contrast among them), and a
// picture of each view in test/shots.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { Fake } from "../dev/fake.mjs";
import { result } from "../dev/margins.mjs";
import { drawn, launch, missing, open, SCREENS, SHOTS, until, WHOLE } from "./browser.mjs";

const AXE = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

let browser;
before(async () => { if (!missing) browser = await launch(); });
after(async () => { await browser?.close(); });

/** Holds all flashes in one half, so that a check does not see a change; returns whether anything flashes. */
const hold = (page, half) => page.evaluate((at) => {
  const flashing = document.getAnimations();
  for (const animation of flashing) {
    animation.pause();
    animation.currentTime = at * animation.effect.getComputedTiming().duration;
  }
  return flashing.length > 0;
}, half);

const release = (page) => page.evaluate(() => { for (const animation of document.getAnimations()) animation.play(); });

/** What axe-core finds wrong in a part of the page. */
async function violations(page, where, options = {}) {
  const { violations: list } = await page.evaluate(([part, chosen]) => window.axe.run(part, { resultTypes: ["violations"], ...chosen }), [where, options]);
  return list.map(({ id, nodes }) => `${id}: ${nodes.map(({ target, failureSummary }) => `${target} ${failureSummary}`).join("; ")}`);
}

/** Checks a view: everything in one half of a flash, and what flashes in the other, too. */
async function check(page, name) {
  const flashing = await hold(page, 0.25);
  const found = await violations(page, "html");
  if (flashing) {
    await hold(page, 0.75);
    found.push(...(await violations(page, ".banner", { runOnly: ["color-contrast"] })));
  }
  await release(page);
  assert.deepEqual(found, [], name);
  const [wide, screen] = await page.evaluate(() => [document.documentElement.scrollWidth, window.innerWidth]);
  assert.ok(wide <= screen, `${name} is ${wide - screen} pixels too wide`);
  await page.screenshot({ path: join(SHOTS, `${name}.png`) });
}

for (const [screen, options] of Object.entries(SCREENS)) {
  test(`the views on ${screen}: no violation, no overflow`, { skip: missing, timeout: WHOLE }, async () => {
    const fake = new Fake({ steer: true, demo: true });
    const page = await open(browser, await fake.start(), options);
    // axe-core is given by the driver, past the page's policy.
    await page.evaluate(AXE);
    const open_ = async (tab) => {
      await page.getByRole("tab", { name: tab }).click();
      await page.getByRole("tabpanel", { name: tab }).waitFor();
      await drawn(page);
    };
    try {
      await until(page, () => window.eupnea?.devices.length > 0 && window.eupnea.devices.every(({ breath }) => breath !== null));
      fake.alarm(4, "leak", "low", "Leak");
      fake.fault(fake.devices[3], "disconnect");
      fake.devices[5].mute = true;
      fake.alarm(1, "rate", "medium", "Rate above the set rate");
      await until(page, () => document.querySelectorAll('.card .banner:not([data-priority="none"])').length === 4 && document.querySelector(".card.stale") !== null);
      await check(page, `wall-${screen}`);
      await page.getByRole("button", { name: "Open R 5 C 50, learned" }).click();
      // Two breaths make a loop with the one before it.
      await until(page, (known) => window.eupnea.devices[1].breath.number > known + 1, await page.evaluate(() => window.eupnea.devices[1].breath.number));
      await check(page, `loops-${screen}`);
      for (const tab of ["Trends", "Alarms", "Settings", "Record", "Tuning"]) {
        await open_(tab);
        if (tab === "Settings") {
          await page.getByRole("button", { name: "Take control" }).click();
          await until(page, () => !document.querySelector("#setting-pip").disabled);
        }
        if (tab === "Record") {
          await page.getByRole("button", { name: "Read the flight recorder" }).click();
          await until(page, () => document.querySelectorAll(".record .chart canvas").length === 4);
        }
        if (tab === "Tuning") {
          fake.measured(1, result());
          await until(page, () => document.querySelectorAll(".margins .chart .uplot").length === 5);
          await drawn(page);
        }
        await check(page, `${tab.toLowerCase()}-${screen}`);
      }
      await page.getByRole("button", { name: "Freeze" }).click();
      await page.getByRole("slider", { name: "Cursor A" }).focus();
      await check(page, `frozen-${screen}`);
      await page.getByRole("button", { name: "Run", exact: true }).click();
      await open_("Settings");
      await page.locator("#setting-pip").fill("40");
      await page.locator("#setting-pip").press("Enter");
      await page.locator("dialog").waitFor();
      await check(page, `confirm-${screen}`);
      await page.keyboard.press("Escape");
      fake.stalled = true;
      await until(page, () => !document.querySelector(".shade").hidden);
      await check(page, `no-data-${screen}`);
      assert.deepEqual(page.errors, []);
    } finally {
      await page.context().close();
      await fake.stop();
    }
  });
}
