// The page without a server: its devices run in WebAssembly beside it, or are boards at this computer.

import { run } from "./app";
import { Boards } from "./boards";
import { Local } from "./local";

run((listener) => {
  const local = new Local("demo.wasm", listener);
  document.body.append(new Boards(local).element);
  return local;
});
