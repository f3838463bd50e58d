// What the browser tests have in common: Chromium of the system, pages, and waiting.

import { existsSync } from "node:fs";
import { mkdir } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const HERE = dirname(fileURLToPath(import.meta.url));
export const SHOTS = join(HERE, "shots");
const CHROMIUM = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find((path) => path && existsSync(path));

/** Why the tests cannot run; false if they can. */
export const missing = CHROMIUM ? false : "no Chromium: run apt-get install chromium, or set CHROMIUM";

export async function launch(args = []) {
  await mkdir(SHOTS, { recursive: true });
  return chromium.launch({ executablePath: CHROMIUM, args: ["--no-sandbox", "--autoplay-policy=no-user-gesture-required", ...args] });
}

/** Opens a page; errors of its scripts and its policy are collected in `page.errors`. */
export async function open(browser, url, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, bypassCSP: false, ...options });
  const page = await context.newPage();
  page.errors = [];
  page.outside = [];
  page.on("pageerror", (error) => page.errors.push(String(error)));
  page.on("console", (message) => { if (message.type() === "error" && !/WebSocket|ERR_CONNECTION/.test(message.text())) page.errors.push(message.text()); });
  page.on("request", (request) => { if (!request.url().startsWith(new URL(url).origin) && !request.url().startsWith("data:")) page.outside.push(request.url()); });
  await page.goto(url);
  return page;
}

export const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Waits until a function in the page is true. */
export const until = (page, test, argument, timeout = 30_000) => page.waitForFunction(test, argument, { timeout, polling: 20 });

/** Counts the pixels of a strip's curves that are painted. */
export const painted = (page, strip) => page.evaluate((name) => {
  const canvas = document.querySelector(`.strip-${name} .layer`);
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let index = 3; index < data.length; index += 4) if (data[index] > 0) count += 1;
  return count;
}, strip);
