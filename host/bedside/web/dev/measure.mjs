// Measures the page in headless Chromium against the fake server or another address: pictures a second, processor time of the page's
// main thread, memory after garbage collection, and the delay from a control tick to its picture. With the address that
// `trainer serve --steer` has printed, it starts the first device and reads the delays from /metrics; with the server's process id, on
// Linux, it prints the server's share of a core.
//
//     node dev/measure.mjs [seconds] [address] [process]

import { readFile } from "node:fs/promises";
import { launch, open, sleep, until } from "../test/browser.mjs";
import { Fake } from "./fake.mjs";

const seconds = Number(process.argv[2] ?? 20);
const fake = process.argv[3] ? null : new Fake({ demo: true });
const url = process.argv[3] ?? (await fake.start());
const server = process.argv[4];
const browser = await launch();
const page = await open(browser, url, { viewport: { width: 1920, height: 1080 } });
const session = await page.context().newCDPSession(page);
await session.send("Performance.enable");
await session.send("HeapProfiler.enable");

async function look() {
  await session.send("HeapProfiler.collectGarbage");
  const { metrics } = await session.send("Performance.getMetrics");
  const value = (name) => metrics.find((one) => one.name === name).value;
  const page_ = await page.evaluate(() => ({ pictures: window.eupnea.pictures, missing: window.eupnea.devices.reduce((sum, { ring }) => sum + ring.missing, 0) }));
  return { time: performance.now() / 1000, busy: value("ThreadTime"), heap: value("JSHeapUsedSize"), nodes: value("Nodes"), ...page_ };
}

/** Processor time of the server so far, s. */
async function busy() {
  const fields = (await readFile(`/proc/${server}/stat`, "utf8")).split(") ")[1].split(" ");
  return (Number(fields[11]) + Number(fields[12])) / 100;
}

/** Starts the device that is shown, unless it ventilates. */
async function start() {
  await page.getByRole("tab", { name: "Settings" }).click();
  await page.getByRole("button", { name: "Take control" }).click();
  await until(page, () => !document.querySelector("#setting-pip").disabled);
  // The self-test of its start takes some seconds, in which a start is refused.
  for (let attempt = 0; attempt < 20 && (await page.getByRole("button", { name: "Start ventilation" }).count()); attempt++) {
    await page.getByRole("button", { name: "Start ventilation" }).click();
    await page.locator("dialog .agree").click();
    await sleep(3000);
  }
  await page.getByRole("button", { name: "Stop ventilation" }).waitFor();
  await page.getByRole("tab", { name: "Loops" }).click();
}

/** Numbers of delays in the classes of the server's histogram: upper bound in ms, and number up to it. */
async function delays() {
  const text = await (await fetch(new URL("/metrics", url))).text();
  return [...text.matchAll(/^eupnea_draw_latency_seconds_bucket\{le="([^"]+)"\} (\d+)$/gm)].map(([, bound, count]) => [bound === "+Inf" ? Infinity : 1000 * bound, Number(count)]);
}

/** Prints the class of the 95th percentile of the delays since `before`. */
function percentile(before, after) {
  const counts = after.map(([bound, count], index) => [bound, count - before[index][1]]);
  const all = counts.at(-1)[1];
  const place = counts.findIndex(([, count]) => count >= 0.95 * all);
  console.log(`${all} delays from control tick to picture; 95 % are at most ${counts[place][0].toFixed(0)} ms: ${counts.map(([bound, count]) => `${count} <= ${bound.toFixed(0)}`).join(", ")}`);
}

async function measure(name) {
  await sleep(3000);
  const [before, busyBefore] = [await look(), server ? await busy() : 0];
  await sleep(1000 * seconds);
  const [after, busyAfter] = [await look(), server ? await busy() : 0];
  const time = after.time - before.time;
  console.log(`${name}: ${((after.pictures - before.pictures) / time).toFixed(1)} pictures/s, main thread ${((100 * (after.busy - before.busy)) / time).toFixed(1)} %, `
    + `heap ${(before.heap / 1e6).toFixed(1)} then ${(after.heap / 1e6).toFixed(1)} MB, nodes ${before.nodes} then ${after.nodes}, missing ${after.missing}`);
  if (server) console.log(`server ${((100 * (busyAfter - busyBefore)) / time).toFixed(1)} % of a core`);
}

await until(page, () => window.eupnea?.devices.length > 0);
if (await page.evaluate(() => window.eupnea.devices.length > 1)) {
  await measure("wall");
  await page.locator(".card-open").first().click();
}
if (url.includes("#token=")) await start();
const known = fake ? [] : await delays();
await measure("one device, loops");
if (!fake) percentile(known, await delays());
if (fake) {
  const last = fake.drawn.slice(-200);
  console.log(`${fake.drawn.length} reports of drawn ticks, the last for tick ${last.at(-1).tick} of ${fake.devices[last.at(-1).device].lung.tick}`);
}
await browser.close();
await fake?.stop();
