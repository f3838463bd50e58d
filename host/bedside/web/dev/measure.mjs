// Measures the page in headless Chromium against the fake server or another address: pictures a second, processor time of the page's
// main thread, memory after garbage collection, and the delay from the server's newest tick to the drawn one.
//
//     node dev/measure.mjs [seconds] [address]

import { launch, open, sleep, until } from "../test/browser.mjs";
import { Fake } from "./fake.mjs";

const seconds = Number(process.argv[2] ?? 20);
const fake = process.argv[3] ? null : new Fake({ demo: true });
const url = process.argv[3] ?? (await fake.start());
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

async function measure(name) {
  await sleep(3000);
  const before = await look();
  await sleep(1000 * seconds);
  const after = await look();
  const time = after.time - before.time;
  console.log(`${name}: ${((after.pictures - before.pictures) / time).toFixed(1)} pictures/s, main thread ${((100 * (after.busy - before.busy)) / time).toFixed(1)} %, `
    + `heap ${(before.heap / 1e6).toFixed(1)} then ${(after.heap / 1e6).toFixed(1)} MB, nodes ${before.nodes} then ${after.nodes}, missing ${after.missing}`);
}

await until(page, () => window.eupnea?.devices.length > 0);
if (await page.evaluate(() => window.eupnea.devices.length > 1)) {
  await measure("wall");
  await page.locator(".card-open").first().click();
}
await measure("one device, loops");
if (fake) {
  const last = fake.drawn.slice(-200);
  console.log(`${fake.drawn.length} reports of drawn ticks, the last for tick ${last.at(-1).tick} of ${fake.devices[last.at(-1).device].lung.tick}`);
}
await browser.close();
await fake?.stop();
