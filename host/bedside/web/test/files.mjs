// A plain server of the files of the page without a server, in a folder, as on a site of documents.

import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { dirname, extname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";

const FOLDER = process.env.DEMO ?? join(dirname(fileURLToPath(import.meta.url)), "../../../../docs/demo");
/** Of the module's type it knows nothing. */
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css" };

/** Starts the server: its page's address, itself, and a function that ends it. */
export async function files() {
  const server = createServer(async (request, response) => {
    const path = normalize(new URL(request.url, "http://any").pathname);
    const name = path.endsWith("/") ? `${path}index.html` : path;
    const contents = name.startsWith("/some/folder/") ? await readFile(join(FOLDER, name.slice("/some/folder".length))).catch(() => null) : null;
    response.writeHead(contents ? 200 : 404, { "Content-Type": TYPES[extname(name)] ?? "application/octet-stream" }).end(contents ?? "");
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return { url: `http://127.0.0.1:${server.address().port}/some/folder/`, server, close: () => server.close() };
}
