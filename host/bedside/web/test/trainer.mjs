// The trainer, named by the environment's TRAINER, and the real image in QEMU, whose images are in the environment's IMAGES.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { eventually, missing, painted, skips, until } from "./browser.mjs";

export const { TRAINER, IMAGES } = process.env;
export const skip = missing || skips(TRAINER ? "" : "no TRAINER: name the trainer binary");
export const skipBoard = skip || skips(IMAGES ? "" : "no IMAGES: name the folder of the firmware's images");

/** Runs the trainer until a line on its output matches; what it matched, and a function that kills the process. */
export async function run(args, pattern) {
  const child = spawn(TRAINER, args, { stdio: ["ignore", "pipe", "pipe"] });
  const ended = new Promise((resolve) => child.on("exit", resolve));
  let [text, said] = ["", ""];
  child.stderr.on("data", (data) => { said = (said + data).slice(-2000); });
  const kill = () => { child.kill("SIGKILL"); return ended; };
  const found = await Promise.race([
    ended,
    new Promise((resolve) => child.stdout.on("data", (data) => {
      text += data;
      const match = pattern.exec(text);
      if (match) resolve(match);
    })),
  ]);
  if (!Array.isArray(found)) throw new Error(`trainer ${args.join(" ")} ended with ${found}: ${said}`);
  return { found, kill };
}

/** The real image in QEMU. A port of a board that has just died may be taken for some time. */
export async function board(port = 0) {
  let started = null;
  await eventually(async () => {
    started = await run(["qemu", "--listen", String(port), "--images", IMAGES], /tcp:127\.0\.0\.1:(\d+)\n/).catch((error) => {
      if (port === 0) throw error;
      return null;
    });
    return started;
  }, "the board starts");
  return { port: Number(started.found[1]), kill: started.kill };
}

/** Takes control of the shown device and starts it. */
export async function startVentilation(page) {
  await page.getByRole("tab", { name: "Settings" }).click();
  const take = page.getByRole("button", { name: "Take control" });
  if (await take.isVisible()) await take.click();
  await page.getByRole("button", { name: "Start ventilation" }).click();
  await page.locator("dialog .agree").click();
  await page.getByRole("button", { name: "Stop ventilation" }).waitFor();
}

/** Waits until the shown device breathes and its curves are drawn. */
export const breathes = async (page) => {
  await until(page, () => window.eupnea.devices[0].breath?.number > 0 && window.eupnea.devices[0].ring.end > 4000);
  for (const strip of ["pressure", "flow", "volume", "valves"]) assert.ok((await painted(page, strip)) > 300, strip);
};
