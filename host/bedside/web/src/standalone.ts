// The page without a server: its devices run in WebAssembly beside it.

import { run } from "./app";
import { Local } from "./local";

run((listener) => new Local("demo.wasm", listener));
