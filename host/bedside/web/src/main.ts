// The page of a server.

import { run } from "./app";
import { Socket } from "./socket";

run((listener) => new Socket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/stream`, listener));
