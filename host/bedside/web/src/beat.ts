// A timer in a worker: a browser throttles the timers of a hidden page to one a second or a minute, but not those of a worker.
//
// The worker runs the page's own script, which begins with `work` where there is no document; so the server needs no other file.

/** The used part of a worker's global scope; TypeScript knows only that of a page. */
interface Scope {
  onmessage: ((event: MessageEvent<number>) => void) | null;
  postMessage(message: null): void;
}

/** Whether this script runs in the worker. */
export const inWorker = typeof document === "undefined";

/** Calls a function in the page every so many ms. */
export function every(interval: number, run: () => void): void {
  const worker = new Worker(import.meta.url, { type: "module" });
  worker.onmessage = run;
  // A throttled timer is better than none.
  worker.addEventListener("error", () => { setInterval(run, interval); }, { once: true });
  worker.postMessage(interval);
}

/** The worker's part. */
export function work(): void {
  const scope = globalThis as unknown as Scope;
  scope.onmessage = ({ data }) => { setInterval(() => scope.postMessage(null), data); };
}
