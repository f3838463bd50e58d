// Builds the page into dist/ with esbuild, or with --tests the unit tests into out/.
//
// The output depends on the sources and the pinned packages alone, so that CI can compare it with the committed files.
// With --check, builds into memory and fails if dist/ differs or is too large.

import { readFile, writeFile, mkdir, rm, readdir } from "node:fs/promises";
import { gzipSync } from "node:zlib";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const HERE = dirname(fileURLToPath(import.meta.url));
const DIST = join(HERE, "dist");
/** Largest size of the bundle, compressed, in bytes. */
const LARGEST = 150_000;

/** The licence of uPlot, which its minified file only names. */
async function licences() {
  const text = await readFile(join(HERE, "node_modules/uplot/LICENSE"), "utf8");
  const { version } = JSON.parse(await readFile(join(HERE, "node_modules/uplot/package.json"), "utf8"));
  return `/*! Eupnea, MIT OR Apache-2.0. Contains uPlot ${version}, under this licence:\n\n${text.trim()}\n*/`;
}

/** The files of the page: name and contents. */
async function page() {
  const note = await licences();
  const result = await build({
    absWorkingDir: HERE,
    entryPoints: { app: "src/app.ts" },
    outdir: DIST,
    bundle: true,
    minify: true,
    write: false,
    format: "esm",
    target: "es2022",
    charset: "utf8",
    legalComments: "none",
    banner: { js: note, css: note },
  });
  const files = result.outputFiles.map(({ path, contents }) => [path.slice(DIST.length + 1), Buffer.from(contents)]);
  files.push(["index.html", await readFile(join(HERE, "src/index.html"))]);
  return new Map(files.sort(([a], [b]) => (a < b ? -1 : 1)));
}

/** Prints the sizes and fails above the limit. */
function weigh(files) {
  let total = 0;
  for (const [name, contents] of files) {
    const packed = gzipSync(contents, { level: 9 }).length;
    total += packed;
    console.log(`${name}: ${contents.length} bytes, ${packed} compressed`);
  }
  console.log(`in all ${total} bytes compressed, at most ${LARGEST}`);
  if (total > LARGEST) throw new Error("the bundle is too large: remove code or raise LARGEST with a reason");
}

async function buildPage() {
  const files = await page();
  await mkdir(DIST, { recursive: true });
  for (const [name, contents] of files) await writeFile(join(DIST, name), contents);
  weigh(files);
}

async function checkPage() {
  const files = await page();
  for (const [name, contents] of files) {
    const committed = await readFile(join(DIST, name)).catch(() => Buffer.alloc(0));
    if (!committed.equals(contents)) throw new Error(`dist/${name} is not what the sources give: run npm run build`);
  }
  console.log("dist/ is what the sources give");
  weigh(files);
}

async function buildTests() {
  const names = (await readdir(join(HERE, "test"))).filter((name) => name.endsWith(".test.ts"));
  const out = join(HERE, "out");
  await rm(out, { recursive: true, force: true });
  await build({
    absWorkingDir: HERE,
    entryPoints: names.map((name) => join("test", name)),
    outdir: out,
    bundle: true,
    platform: "node",
    format: "esm",
    target: "node20",
    outExtension: { ".js": ".mjs" },
    logLevel: "warning",
  });
}

if (process.argv.includes("--tests")) await buildTests();
else if (process.argv.includes("--check")) await checkPage();
else await buildPage();
