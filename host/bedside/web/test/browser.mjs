// What the browser tests have in common: Chromium of the system, pages, and waiting.
//
// No test waits for a time that a slow machine could miss: each waits for a condition, and its deadline only ends a test that hangs.

import { existsSync } from "node:fs";
import { mkdir } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const HERE = dirname(fileURLToPath(import.meta.url));
export const SHOTS = join(HERE, "shots");
const CHROMIUM = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find((path) => path && existsSync(path));
/** Longest wait for a condition, ms. */
export const LONG = 600_000;
/** Longest time of a test, ms. */
export const WHOLE = 1_800_000;

export const SCREENS = {
  "1280x800": { viewport: { width: 1280, height: 800 } },
  "1920x1080": { viewport: { width: 1920, height: 1080 } },
  phone: { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true },
};

/** The reason to leave tests out, if there is one; with SKIP_NOTHING in the environment they fail instead. */
export function skips(reason) {
  if (reason && process.env.SKIP_NOTHING) throw new Error(reason);
  return reason || false;
}

/** Why the tests cannot run; false if they can. */
export const missing = skips(CHROMIUM ? "" : "no Chromium: run apt-get install chromium, or set CHROMIUM");

export async function launch(args = []) {
  await mkdir(SHOTS, { recursive: true });
  return chromium.launch({ executablePath: CHROMIUM, args: ["--no-sandbox", "--autoplay-policy=no-user-gesture-required", ...args] });
}

/**
 * Opens a page. Errors of its scripts and its policy are collected in `page.errors`, requests to another origin in `page.outside`, and
 * the response with the document is `page.response`.
 */
export async function open(browser, url, options = {}) {
  const context = await browser.newContext({ ...SCREENS["1280x800"], ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(LONG);
  page.errors = [];
  page.outside = [];
  const { host } = new URL(url);
  page.on("pageerror", (error) => page.errors.push(String(error)));
  page.on("console", (message) => { if (message.type() === "error" && !/WebSocket|ERR_CONNECTION/.test(message.text())) page.errors.push(message.text()); });
  const look = (address) => { if (new URL(address).protocol !== "data:" && new URL(address).host !== host) page.outside.push(address); };
  page.on("request", (request) => look(request.url()));
  page.on("websocket", (socket) => look(socket.url()));
  page.response = await page.goto(url);
  return page;
}

export const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Waits until a function in the page is true. */
export const until = (page, test, argument, timeout = LONG) => page.waitForFunction(test, argument, { timeout, polling: 50 });

/** Waits until a function here is true. */
export async function eventually(test, what) {
  for (const begin = Date.now(); Date.now() - begin < LONG; await sleep(20)) if (await test()) return;
  throw new Error(`this did not happen: ${what}`);
}

/** Waits until the first element of a selector has this text, or one that matches. */
export async function says(page, selector, wanted) {
  const element = page.locator(selector).first();
  const fits = (found) => (typeof wanted === "string" ? found === wanted : wanted.test(found));
  await eventually(async () => fits(await element.textContent()), `${selector} says ${wanted}`);
}

/** Waits until the page knows the state of every device. */
export const known = (page) => until(page, () => window.eupnea?.devices.length > 0 && window.eupnea.devices.every(({ state }) => state !== null));

/** Counts the pixels of a strip's curves that are painted. */
export const painted = (page, strip) => page.evaluate((name) => {
  const canvas = document.querySelector(`.strip-${name} .layer`);
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let index = 3; index < data.length; index += 4) if (data[index] > 0) count += 1;
  return count;
}, strip);

/**
 * Counts, from now on, how often the page finds a device silent. An overloaded machine holds up even the states of a fake device; the page
 * then rightly raises "No data", which ends a pause of the sound.
 */
export const countSilences = (page) => page.evaluate(() => {
  window.silences = 0;
  for (const device of window.eupnea.devices) {
    let since = device.silentSince;
    const set = (value) => {
      if (value !== null && since === null) window.silences += 1;
      since = value;
    };
    Object.defineProperty(device, "silentSince", { get: () => since, set });
  }
});

export const silences = (page) => page.evaluate(() => window.silences);

/** Waits until a picture of the page has been drawn from what it knows now. */
export const drawn = (page) => page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));

/**
 * Flashes of the banner in a second, by the times of the browser's own pictures: `count` of them, from one change to bright or dark to
 * a later one of the same kind. If two pictures are so far apart that a change between them could be missed, the measurement begins
 * again. `most` is the highest rate of the band, 1/s.
 */
export const flashes = (page, count, most) => page.evaluate(([wanted, gap]) => new Promise((resolve) => {
  const banner = document.querySelector("#banner");
  let [changes, known, last] = [[], null, null];
  const look = (now) => {
    const colour = getComputedStyle(banner).backgroundColor;
    if (last === null || now - last > gap) changes = [];
    else if (colour !== known) changes.push(now);
    [known, last] = [colour, now];
    if (changes.length > 2 * wanted) resolve((1000 * wanted) / (changes[2 * wanted] - changes[0]));
    else requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}), [count, 500 / most]);

/** Longest time between two looks of the page in a measurement of its own times, ms: twice what it means to take. */
const LATE = 80;

/**
 * Time from the last message to the page's telling it, ms, by the browser's own clock. If the machine held the page's timer up meanwhile,
 * the time is not the page's, and the measurement begins again. `stall` ends the messages, or lets them go on.
 */
export async function silence(page, stall) {
  await page.addInitScript(() => {
    window.beats = [];
    window.Worker = class extends Worker {
      constructor(...described) {
        super(...described);
        this.addEventListener("message", () => window.beats.push(performance.now()));
      }
    };
  });
  await page.reload();
  for (;;) {
    await until(page, () => window.eupnea?.devices[0]?.ring.end > 1000 && document.querySelector(".shade").hidden);
    const told = page.evaluate((late) => new Promise((resolve) => {
      const shade = document.querySelector(".shade");
      window.beats.length = 0;
      new MutationObserver((_, observer) => {
        if (shade.hidden) return;
        observer.disconnect();
        const times = [...window.beats, performance.now()];
        resolve(times.some((time, index) => time - times[index - 1] > late) ? null : times.at(-1) - window.eupnea.socket.heard);
      }).observe(shade, { attributes: true });
    }), LATE);
    stall(true);
    const time = await told;
    if (time !== null) return time;
    stall(false);
  }
}

/** Whether the banner keeps its colour for 1.5 s of the browser's pictures: longer than half a flash of any band. */
export const steady = (page) => page.evaluate(() => new Promise((resolve) => {
  const banner = document.querySelector("#banner");
  const colour = () => getComputedStyle(banner).backgroundColor;
  const first = colour();
  let begin = null;
  const look = (now) => {
    begin ??= now;
    if (colour() !== first) resolve(false);
    else if (now - begin > 1500) resolve(true);
    else requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}));
