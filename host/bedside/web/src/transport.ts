// What carries the stream between the page and the devices: a server's socket, or the devices in the page itself.

import { decodeSamples, decodeText, type Message, type Samples } from "./stream";

export interface Listener {
  opened(): void;
  /** `refused` tells that the server closed it for a broken rule soon after it was opened. */
  closed(reason: string, refused: boolean): void;
  message(message: Message): void;
  samples(samples: Samples): void;
}

export interface Transport {
  readonly connected: boolean;
  /** Whether the devices are still being loaded into the page, so that their silence is no alarm. */
  readonly loading: boolean;
  /** Seconds until the next attempt to connect. */
  readonly waits: number;
  /** When anything arrived last, by performance.now(). */
  readonly heard: number;
  /** Messages that did not decode. */
  readonly malformed: number;
  /** Keeps the connection alive: call it several times a second, also in a hidden page. */
  keep(now: number): void;
  /** Sends an object; false if there is no connection, and then nothing is sent later either. */
  send(message: object): boolean;
}

/** Opens a transport for a listener. */
export type Connect = (listener: Listener) => Transport;

/** Decodes what has arrived and hands it on; false if it does not decode. */
export function deliver(data: string | ArrayBuffer, listener: Listener): boolean {
  if (typeof data === "string") {
    const message = decodeText(data);
    if (message) listener.message(message);
    return message !== null;
  }
  const samples = decodeSamples(data);
  if (samples) listener.samples(samples);
  return samples !== null;
}
