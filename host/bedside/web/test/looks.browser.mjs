// How the page looks on three screens: nothing beside the edge, no violation found by axe-core (contrast among them), and a
// screenshot of each into test/shots.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { Fake } from "../dev/fake.mjs";
import { launch, missing, open, SHOTS, sleep, until } from "./browser.mjs";

const AXE = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const SCREENS = {
  "1280x800": { viewport: { width: 1280, height: 800 } },
  "1920x1080": { viewport: { width: 1920, height: 1080 } },
  phone: { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true },
};

let browser;
before(async () => { if (!missing) browser = await launch(); });
after(async () => { await browser?.close(); });

/** Violations that axe-core finds; its script is injected by the driver, past the page's policy. */
async function violations(page) {
  await page.evaluate(AXE);
  // In both halves of a flash.
  const found = [];
  for (let look = 0; look < 2; look++) {
    const { violations: list } = await page.evaluate(() => window.axe.run(document, { resultTypes: ["violations"] }));
    found.push(...list.map(({ id, nodes }) => `${id}: ${nodes.map(({ target, failureSummary }) => `${target} ${failureSummary}`).join("; ")}`));
    await sleep(270);
  }
  return found;
}

async function check(page, name) {
  assert.deepEqual(await violations(page), [], name);
  const [wide, screen] = await page.evaluate(() => [document.documentElement.scrollWidth, window.innerWidth]);
  assert.ok(wide <= screen, `${name} is ${wide - screen} pixels too wide`);
  await page.screenshot({ path: join(SHOTS, `${name}.png`) });
}

for (const [screen, options] of Object.entries(SCREENS)) {
  test(`the views on ${screen}`, { skip: missing, timeout: 180_000 }, async () => {
    const fake = new Fake({ steer: true, demo: true });
    const page = await open(browser, await fake.start(), options);
    try {
      await until(page, () => window.eupnea?.devices[0]?.breath !== null);
      await sleep(3000);
      fake.alarm(4, "leak", "low", "Leak");
      fake.fault({ ...fake.devices[3], lung: fake.devices[3].lung, id: 3 }, "disconnect");
      fake.alarm(1, "rate", "medium", "Rate above the set rate");
      await sleep(300);
      await check(page, `wall-${screen}`);
      await page.getByRole("button", { name: "Open R 5 C 50, learned" }).click();
      await until(page, () => window.eupnea.devices[1].ring.end > 20_000 || window.eupnea.devices[1].breath.number > 5, undefined, 60_000);
      await check(page, `loops-${screen}`);
      for (const tab of ["Trends", "Alarms", "Settings", "Record"]) {
        await page.getByRole("tab", { name: tab }).click();
        if (tab === "Settings") await page.getByRole("button", { name: "Take control" }).click();
        await sleep(2200);
        await check(page, `${tab.toLowerCase()}-${screen}`);
      }
      await page.getByRole("button", { name: "Freeze" }).click();
      await page.getByRole("slider", { name: "Cursor A" }).focus();
      await check(page, `frozen-${screen}`);
      await page.getByRole("button", { name: "Run", exact: true }).click();
      await page.getByRole("tab", { name: "Settings" }).click();
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
