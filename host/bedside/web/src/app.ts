// The page: connects the stream with the views, and keeps time.
//
// Curves are drawn at the display's rate. Texts, alarms and sound are updated ten times a second: with the messages, and by a timer in
// a worker, because a hidden page draws no pictures and its timers are throttled, but it must still notice that nothing arrives.

import "uplot/dist/uPlot.min.css";
import "./app.css";
import { inSafeState, noData } from "./alarms";
import { Audio } from "./audio";
import { every, inWorker, work } from "./beat";
import { Bedside } from "./bedside";
import { Demo } from "./demo";
import { Device, SILENCE_MS } from "./device";
import { confirm, inform } from "./dialog";
import { button, h, show } from "./dom";
import { Head } from "./head";
import { listen } from "./keys";
import { group } from "./pairs";
import { Requests } from "./requests";
import { type Alarm, type Hello, type Message, type Samples, VERSION } from "./stream";
import { forget, token } from "./token";
import type { Connect, Transport } from "./transport";
import { Wall } from "./wall";

/** Interval between two updates of texts, and between two looks for silence, ms. */
const UPDATE_EVERY = 100;
const LOOK_EVERY = 40;
/** Least interval between two reports of what has been drawn, ms. */
const REPORT_EVERY = 110;
/** Shown if the server does not serve a page with this token, or without one. */
const REFUSED = "Token refused: open the address that the server has printed";
const NO_TOKEN = "No answer. If the server needs a token, open the address that it has printed";

class App {
  readonly devices: Device[] = [];
  private token = token();
  /** Whether the server has refused the token. */
  private tokenRefused = false;
  private readonly requests = new Requests((message) => this.send(message));
  private readonly audio = new Audio(this.requests);
  private readonly demo = new Demo(this.requests, (message) => this.send(message));
  private readonly wall = new Wall((device) => this.open(device));
  private readonly head: Head;
  private readonly main: HTMLElement;
  readonly bedside: Bedside;
  readonly socket: Transport;
  private hello: Hello | null = null;
  /** Whether the server has greeted the page since the connection was opened: only then it serves the page. */
  private greeted = false;
  /** When the connection was opened, by performance.now(). */
  private openedAt = 0;
  /** When the page began to wait for the first greeting: by performance.now(), and Unix ms. */
  private readonly waiting = { from: performance.now(), since_ms: Date.now() };
  /** The shown device; null shows the wall. */
  private shown: Device | null = null;
  private trouble = "";
  private reported = 0;
  private updated = 0;
  /** Silent devices at the last update. */
  private silentDevices = 0;
  /** Pictures drawn so far. */
  pictures = 0;

  constructor(connect: Connect) {
    const help = listen(this.shortcuts());
    const extra = h("div", { class: "extra" }, this.demo.element, button("Keys", help, { class: "help" }));
    this.bedside = new Bedside(this.requests, (message) => this.send(message), extra);
    this.head = new Head({ wall: () => this.open(null), choose: (device) => this.open(device), acknowledge: () => this.acknowledge() }, this.audio.element);
    this.main = h("main", { id: "main", tabindex: "-1" }, this.wall.element, this.bedside.element);
    document.body.append(h("a", { class: "skip", href: "#main" }, "Skip to the waveforms"), this.head.element, this.main);
    show(this.demo.element, false);
    this.socket = connect({
      opened: () => this.opened(), closed: (reason, refused) => this.closed(reason, refused),
      message: (message) => this.take(message), samples: (samples) => this.takeSamples(samples),
    });
    every(LOOK_EVERY, () => this.look());
    requestAnimationFrame((now) => this.draw(now));
  }

  private send(message: object): boolean {
    return this.socket.send(message);
  }

  private opened(): void {
    this.openedAt = performance.now();
    if (this.token !== null) this.send({ type: "token", token: this.token });
  }

  private closed(reason: string, refused: boolean): void {
    this.trouble = refused && !this.greeted && this.token !== null ? REFUSED : reason;
    this.greeted = false;
    if (refused && this.token !== null) {
      forget();
      this.token = null;
      this.tokenRefused = true;
    }
    this.requests.abandon();
    for (const device of this.devices) device.yours = false;
  }

  private take(message: Message): void {
    const device = "device" in message ? this.devices.find(({ info }) => info.id === message.device) : undefined;
    switch (message.type) {
      case "hello": this.greet(message); break;
      case "answer": this.requests.take(message); break;
      case "state": device?.takeState(message, performance.now()); break;
      case "breath": device?.takeBreath(message, performance.now()); break;
      case "event": device?.takeEvent(message); break;
      case "history": device?.trends.load(message); break;
      case "verdict": if (device) device.verdict = message; break;
      case "recorder": if (device) device.recorder = message; break;
      case "margins": if (device) device.margins = message; break;
      case "steerer": if (device) device.yours = message.yours;
    }
    this.updateIfDue();
  }

  private takeSamples(samples: Samples): void {
    this.devices.find(({ info }) => info.id === samples.device)?.takeSamples(samples, performance.now());
    this.updateIfDue();
  }

  private greet(hello: Hello): void {
    this.trouble = hello.version === VERSION ? "" : `The server speaks version ${hello.version} of the stream. Reload this page.`;
    const same = JSON.stringify(hello) === JSON.stringify(this.hello);
    this.hello = hello;
    this.greeted = true;
    // After a reconnection the devices keep their samples and trends.
    if (!same) this.describe(hello);
    this.watch();
  }

  private describe(hello: Hello): void {
    const known = new Map(this.devices.map((device) => [JSON.stringify(device.info), device]));
    this.devices.splice(0, this.devices.length, ...hello.devices.map((info) => known.get(JSON.stringify(info)) ?? new Device(info)));
    for (const pair of group(this.devices, ({ info }) => info.name)) {
      const [first, second] = pair;
      if (first) first.partner = second ?? null;
      if (second && first) second.partner = first;
    }
    this.head.describe(this.devices);
    this.wall.describe(this.devices);
    this.bedside.steer.describe(hello.settings, hello.large_change);
    this.bedside.describe(hello.measure);
    this.audio.longest = hello.audio_pause_max;
    show(this.demo.element, hello.demo);
    const [only] = this.devices;
    if (this.shown === null || !this.devices.includes(this.shown)) this.open(this.devices.length === 1 && only ? only : null);
  }

  /** Shows a device, or the wall. */
  private open(device: Device | null): void {
    if (device !== this.shown) this.bedside.leave();
    this.shown = device;
    show(this.wall.element, device === null);
    show(this.bedside.element, device !== null);
    // On a phone the wall may have been scrolled; the waveforms are at the top.
    this.main.scrollTop = 0;
    if (device) {
      this.bedside.setDevice(device);
      this.demo.update(device);
    }
    this.watch();
    this.update();
  }

  /** Asks for the samples of the devices that are shown. */
  private watch(): void {
    for (const device of this.devices) device.watch(this.shown === null || device === this.shown);
    this.send({ type: "watch", devices: this.devices.filter(({ watched }) => watched).map(({ info }) => info.id) });
  }

  private async acknowledge(): Promise<void> {
    const device = this.shown;
    if (device === null) return;
    const lines = [`${device.info.name} is in its ${device.state?.mode}.`, "Acknowledging the alarm leaves the safe state. Make sure first that its cause is gone."];
    if (inSafeState(device.state) && !(await confirm("Leave the safe state?", lines, "Acknowledge, leave safe state"))) return;
    const answer = await this.requests.ask("acknowledge", device.info.id);
    if (!answer.ok) inform("Not acknowledged", h("p", {}, answer.text));
  }

  private updateIfDue(): void {
    if (performance.now() - this.updated >= UPDATE_EVERY) this.update();
  }

  /** Updates at once when a silence begins or ends, else when it is due. */
  private look(): void {
    const now = performance.now();
    this.socket.keep(now);
    const silent = this.silent(now).length;
    if (silent !== this.silentDevices) this.update();
    else this.updateIfDue();
  }

  private silent(now: number): Device[] {
    return this.devices.filter((device) => device.silent(now, now - this.socket.heard));
  }

  private update(): void {
    const now = performance.now();
    this.updated = now;
    this.silentDevices = this.silent(now).length;
    const own = this.own(now);
    this.head.update(this.shown, own);
    this.head.may(this.shown?.yours ?? false);
    this.connection(now);
    this.audio.update(now, this.devices, this.shown, own);
    if (this.shown) this.bedside.update(this.mayEver(), now);
    else this.wall.update(now);
  }

  /** What the server lets any page do. A page that may steer may record. */
  private mayEver(): { steer: boolean; record: boolean } {
    const { steer, record } = this.hello ?? { steer: false, record: false };
    return { steer, record: record || steer };
  }

  /** The alarm that the page raises before it knows any device: nothing is known of any patient. */
  private own(now: number): Alarm[] {
    const silent = this.hello === null && !this.socket.loading && now - this.waiting.from > SILENCE_MS;
    return silent ? [noData(true, this.waiting.since_ms)] : [];
  }

  private connection(now: number): void {
    const [text, ok] = this.connectionInWords(now);
    this.head.connect(text, ok);
  }

  /** The state of the connection in words, and whether it serves the page. */
  private connectionInWords(now: number): [string, boolean] {
    if (this.socket.loading) return ["Loading", true];
    if (!this.socket.connected) return [`${this.trouble || "No connection"}, next attempt in ${this.socket.waits.toFixed(0)} s`, false];
    if (this.trouble !== "") return [this.trouble, false];
    if (now - this.socket.heard > SILENCE_MS && this.greeted) return ["No data", false];
    if (!this.greeted) return [this.token === null && now - this.openedAt > SILENCE_MS ? NO_TOKEN : "Waiting for the server", false];
    return [this.tokenRefused ? "Read-only: token refused" : "Connected", true];
  }

  private draw(now: number): void {
    requestAnimationFrame((next) => this.draw(next));
    this.pictures += 1;
    if (this.shown) this.report(now, this.shown, this.bedside.draw(now));
    else this.wall.draw();
  }

  /** Reports the oldest tick that is new in a picture, so that the server can measure the longest time from a tick to its picture. */
  private report(now: number, device: Device, tick: number | null): void {
    if (tick === null || now - this.reported < REPORT_EVERY || !this.socket.connected) return;
    this.reported = now;
    this.send({ type: "drawn", device: device.info.id, tick });
  }

  private shortcuts() {
    // On the wall no device is chosen: these keys would act on the one that was shown last.
    const shown = (run: () => void) => () => { if (this.shown !== null) run(); };
    return [
      { key: "f", text: "Freeze the picture, or let it run", run: shown(() => this.bedside.freeze()) },
      { key: "s", text: "Next sweep length", run: shown(() => this.bedside.nextSweep()) },
      { key: "r", text: "Keep the last breath as the reference, or forget it", run: shown(() => this.bedside.reference()) },
      { key: "w", text: "Show the wall of all devices", run: () => { if (this.devices.length > 1) this.open(null); } },
      { key: "p", text: "Pause the alarm sound, or end the pause", run: () => { this.audio.toggle(); } },
      { key: "a", text: "Show the list of alarms", run: shown(() => this.bedside.open("alarms")) },
      { key: "t", text: "Show the settings", run: shown(() => this.bedside.open("settings")) },
      { key: "m", text: "Set a marker", run: shown(() => { this.bedside.record.mark(); }) },
    ];
  }
}

/** Opens the page; in a worker of the page, its part. */
export function run(connect: Connect): void {
  // Tests and the browser's console read the page's state here.
  if (inWorker) work();
  else Object.assign(window, { eupnea: new App(connect) });
}
