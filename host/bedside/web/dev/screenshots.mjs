// Takes the pictures of the documents from the real server's demonstration, and packs them with pngquant.
//
//     cargo xtask web --screenshots

import { spawn, spawnSync } from "node:child_process";
import { mkdir, mkdtemp, rm, stat } from "node:fs/promises";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { launch, LONG, open, SCREENS, until } from "../test/browser.mjs";

const FIGURES = join(dirname(fileURLToPath(import.meta.url)), "../../../../docs/figures");
/** The device on the pictures: a lung on which the PID overshoots. */
const DEVICE = "R5C20 adult";

/** Starts the demonstration; its address, and its process. */
function demonstrate() {
  const server = spawn(process.env.TRAINER, ["serve", "--demo", "--listen", "127.0.0.1:0"], { stdio: ["ignore", "pipe", "inherit"] });
  return new Promise((resolve, reject) => {
    server.stdout.on("data", (text) => resolve([String(text).trim(), server]));
    server.on("exit", (code) => reject(new Error(`trainer serve ended with ${code}`)));
  });
}

const ring = (page) => page.evaluate((name) => window.eupnea.devices.find(({ info }) => info.name === name).ring.end, DEVICE);

/** Waits for a whole sweep of `length` ticks from now on, which is then almost at its end. */
const full = async (page, length) => until(page, ([name, ticks, from]) => {
  const shown = window.eupnea.devices.find(({ info }) => info.name === name).ring;
  return shown.end > from + ticks && shown.newest % ticks > 0.9 * ticks;
}, [DEVICE, length, await ring(page)], 2 * LONG);

async function shoot(page, name, folder) {
  const [raw, packed] = [join(folder, `${name}.png`), join(FIGURES, `${name}.png`)];
  // In the bright half of a flash.
  await page.evaluate(() => { for (const animation of document.getAnimations()) animation.currentTime = 0; });
  await page.screenshot({ path: raw });
  const { status, stderr } = spawnSync("pngquant", ["--force", "--strip", "--speed", "1", "--quality", "50-90", "--output", packed, raw]);
  if (status !== 0) throw new Error(`pngquant: ${stderr}`);
  console.log(`docs/figures/${name}.png: ${(await stat(packed)).size} bytes`);
}

const folder = await mkdtemp(join(tmpdir(), "bedside-"));
const [url, server] = await demonstrate();
const browser = await launch();
try {
  await mkdir(FIGURES, { recursive: true });
  const page = await open(browser, url, SCREENS["1920x1080"]);
  await until(page, () => window.eupnea?.devices.length > 0 && window.eupnea.devices.every(({ breath }) => breath?.number > 1));
  await page.getByRole("button", { name: "Open R50C50 PID" }).click();
  await page.getByRole("button", { name: "Disconnect" }).click();
  await until(page, () => document.querySelector("#banner").dataset.priority === "high");
  await page.keyboard.press("w");
  await page.mouse.move(0, 0);
  await full(page, 6000);
  await shoot(page, "bedside-wall", folder);
  await page.setViewportSize(SCREENS["1280x800"].viewport);
  await page.getByRole("button", { name: `Open ${DEVICE}` }).click();
  await full(page, 12_000);
  await shoot(page, "bedside-device", folder);
  const phone = await open(browser, url, SCREENS.phone);
  await phone.getByRole("button", { name: `Open ${DEVICE}` }).click();
  await phone.evaluate(() => document.querySelector("main").scrollTo(0, 0));
  await full(phone, 12_000);
  await shoot(phone, "bedside-phone", folder);
} finally {
  await browser.close();
  server.kill("SIGKILL");
  await rm(folder, { recursive: true });
}
