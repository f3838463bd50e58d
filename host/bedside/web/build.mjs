// Builds the page into dist/ and the one without a server into docs/demo/ with esbuild, or with --tests the unit tests into out/.
//
// The output depends on the sources and the pinned packages alone, so that CI can compare it with the committed files.
// With --check, builds into memory and fails if they differ or are too large. `cargo xtask web --demo` compiles the module of the page
// without a server.

import { readFile, writeFile, mkdir, rm, readdir } from "node:fs/promises";
import { gzipSync } from "node:zlib";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const HERE = dirname(fileURLToPath(import.meta.url));
const DIST = join(HERE, "dist");
const DEMO = join(HERE, "../../../docs/demo");
/** Largest sizes, compressed, in bytes: of the bundle, and of the page without a server with its module. */
const LARGEST = 150_000;
const LARGEST_DEMO = 1_000_000;
const MODULE = "demo.wasm";
/** Policy of the page without a server, whose files come without a header for it. */
const POLICY = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'";

/** The licence of uPlot, which its minified file only names. */
async function licences() {
  const text = await readFile(join(HERE, "node_modules/uplot/LICENSE"), "utf8");
  const { version } = JSON.parse(await readFile(join(HERE, "node_modules/uplot/package.json"), "utf8"));
  return `/*! Eupnea, MIT OR Apache-2.0. Contains uPlot ${version}, under this licence:\n\n${text.trim()}\n*/`;
}

/** The document of the page without a server: with its policy, with paths that hold in any folder. */
function standalone(document) {
  return document
    .replace("<title>", `<meta http-equiv="Content-Security-Policy" content="${POLICY}">\n<title>`)
    .replaceAll(/(href|src)="\/(app\.)/g, '$1="$2')
    .replace(/<noscript>.*<\/noscript>/, "<noscript><p>This page needs JavaScript and WebAssembly.</p></noscript>");
}

/** The files of a page: name and contents. */
async function page(entry, adapt) {
  const note = await licences();
  const result = await build({
    absWorkingDir: HERE,
    entryPoints: { app: entry },
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
  files.push(["index.html", Buffer.from(adapt(await readFile(join(HERE, "src/index.html"), "utf8")))]);
  return new Map(files.sort(([a], [b]) => (a < b ? -1 : 1)));
}

/** All pages: folder, files and largest size. */
const pages = async () => [
  { folder: DIST, files: await page("src/main.ts", (document) => document), largest: LARGEST },
  { folder: DEMO, files: await page("src/standalone.ts", standalone), largest: LARGEST_DEMO },
];

/** Prints the sizes and fails above the limit. */
function weigh(files, largest) {
  let total = 0;
  for (const [name, contents] of files) {
    const packed = gzipSync(contents, { level: 9 }).length;
    total += packed;
    console.log(`${name}: ${contents.length} bytes, ${packed} compressed`);
  }
  console.log(`in all ${total} bytes compressed, at most ${largest}`);
  if (total > largest) throw new Error("the bundle is too large: remove code or raise its limit with a reason");
}

/** The same with the module of the page without a server. */
async function whole(folder, files) {
  return folder === DEMO ? [...files, [MODULE, await readFile(join(DEMO, MODULE))]] : files;
}

async function buildPages() {
  for (const { folder, files, largest } of await pages()) {
    await mkdir(folder, { recursive: true });
    for (const [name, contents] of files) await writeFile(join(folder, name), contents);
    weigh(await whole(folder, files), largest);
  }
}

async function checkPages() {
  for (const { folder, files, largest } of await pages()) {
    for (const [name, contents] of files) {
      const committed = await readFile(join(folder, name)).catch(() => Buffer.alloc(0));
      if (!committed.equals(contents)) throw new Error(`${join(folder, name)} is not what the sources give: run npm run build`);
    }
    weigh(await whole(folder, files), largest);
  }
  console.log("dist/ and docs/demo/ are what the sources give");
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
else if (process.argv.includes("--check")) await checkPages();
else await buildPages();
