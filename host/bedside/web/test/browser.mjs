// What the browser tests have in common: Chromium of the system, pages, and waiting.
//
// No test waits for a time that a slow machine could miss: each waits for a condition, and its deadline only ends a test that hangs.

import assert from "node:assert/strict";
import { existsSync } from "node:fs";
import { mkdir } from "node:fs/promises";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";
import { Fake } from "../dev/fake.mjs";

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
 * the response with the document is `page.response`. With `held`, the page has the clock of `holdClock`; `devices` is a script, with its
 * argument, that puts devices into the browser.
 */
export async function open(browser, url, { held = false, devices = null, ...options } = {}) {
  const context = await browser.newContext({ ...SCREENS["1280x800"], ...options });
  if (held) await context.addInitScript(holdClock);
  if (devices) await context.addInitScript(...devices);
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

/**
 * The scenes of a file: tests in one browser, each on a page of a fake server of its own. Scripts must not fail, and nothing outside may
 * be asked for. `usual` are options of the page that all scenes share.
 */
export function scenes(usual = {}) {
  let browser;
  before(async () => { if (!missing) browser = await launch(); });
  after(async () => { await browser?.close(); });
  return (name, options, run) => test(name, { skip: missing, timeout: WHOLE }, async () => {
    const fake = new Fake(options);
    const url = await fake.start();
    const page = await open(browser, url, { ...usual, ...options.page });
    try {
      if (!options.listen) await known(page);
      await run(page, fake, url);
      assert.deepEqual(page.errors, []);
      assert.deepEqual(page.outside, []);
    } finally {
      await page.context().close();
      await fake.stop();
    }
  });
}

/** The text of the first element that a selector finds. */
export const text = (page, selector) => page.locator(selector).first().textContent();

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
 * Makes a page's clock advance with the states of its first device: by the time since the last one, but by at most 50 ms. By the
 * machine's clock the page rightly raises "No data" when an overloaded machine holds up the states of a fake device; this alarm flashes,
 * ends a pause of the sound and hides what else the page tells. For the same reason the page never gives up a request.
 * `window.pass` lets some ms pass without a state.
 */
function holdClock() {
  const [real, wait] = [performance.now.bind(performance), setTimeout.bind(window)];
  let [time, since] = [real(), real()];
  performance.now = () => time + Math.min(real() - since, 50);
  window.pass = (ms) => { [time, since] = [performance.now() + ms, real()]; };
  window.setTimeout = (run, ms, ...rest) => wait(run, ms > 1000 ? 2 ** 31 - 1 : ms, ...rest);
  window.WebSocket = class extends WebSocket {
    constructor(...described) {
      super(...described);
      this.addEventListener("message", ({ data }) => {
        const { type, device } = typeof data === "string" ? JSON.parse(data) : {};
        if (type === "state" && device === 0) window.pass(0);
      });
    }
  };
}

/** Lets a time pass in a page with a held clock, ms, and waits until the page has looked for silence since. */
export async function pass(page, ms) {
  await page.evaluate((time) => window.pass(time), ms);
  await until(page, () => window.eupnea.socket.kept === performance.now());
}

/** Waits until the page has updated its texts and its sound from what it knows now. */
export const updated = async (page) => until(page, (known) => window.eupnea.updated > known, await page.evaluate(() => window.eupnea.updated));

/** Waits until a picture of the page has been drawn from what it knows now. */
export const drawn = (page) => page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));

/**
 * Flashes of the banner in a second of its animation: `count` of them, from one change to bright or dark to a later one of the same kind;
 * 0 if it does not run or starts again meanwhile. Each picture of the browser takes the animation 20 ms further: a slow machine, whose
 * pictures are far apart, misses no change either.
 */
export const flashes = (page, count) => page.evaluate(async (wanted) => {
  const banner = document.querySelector("#banner");
  const [animation] = banner.getAnimations();
  if (animation?.playState !== "running" || animation.playbackRate !== 1) return 0;
  await animation.ready;
  animation.pause();
  const changes = [];
  let known = null;
  for (let pictures = 0; changes.length <= 2 * wanted && pictures < 1000; pictures++) {
    await new Promise(requestAnimationFrame);
    if (banner.getAnimations()[0] !== animation) return 0;
    animation.currentTime += 20;
    const colour = getComputedStyle(banner).backgroundColor;
    if (known !== null && colour !== known) changes.push(animation.currentTime);
    known = colour;
  }
  animation.play();
  return changes.length > 2 * wanted ? (1000 * wanted) / (changes[2 * wanted] - changes[0]) : 0;
}, count);

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
