// A fake server for work on the page: serves dist/ and speaks the stream with simulated breaths. Development and tests only.
//
//     npm run fake -- [--demo] [--steer] [--port 8080]

import { createServer } from "node:http";
import { readFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { WebSocketServer } from "ws";
import { encode } from "./encode.mjs";
import { Lung } from "./lung.mjs";

const DIST = join(dirname(fileURLToPath(import.meta.url)), "../dist");
const CSP = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
const FILES = { "/": ["index.html", "text/html; charset=utf-8"], "/app.js": ["app.js", "text/javascript; charset=utf-8"], "/app.css": ["app.css", "text/css; charset=utf-8"] };

const setting = (name, unit, min, max, value, description) => ({ name, unit, min, max, default: value, description });
export const SETTINGS = [
  setting("pip", "cmH2O", 5, 50, 20, "Peak inspiratory pressure"),
  setting("peep", "cmH2O", 0, 20, 5, "Positive end-expiratory pressure"),
  setting("rate", "1/min", 4, 80, 20, "Breaths per minute"),
  setting("inspiratory_time", "s", 0.2, 5, 1, "Length of the inspiration"),
  setting("rise_time", "s", 0, 1, 0, "Time of the rise from PEEP to PIP, 0 for the paper's square waveform"),
  setting("fall_time", "s", 0, 2, 0.5, "Time of the fall from PIP to PEEP"),
  setting("expiratory_bias", "%", 0, 20, 5, "Inspiratory valve while the expiratory valve is open"),
  setting("pressure_limit", "cmH2O", 15, 70, 60, "Pressure above which a breath is ended"),
  setting("trigger_pressure", "cmH2O", 0, 10, Math.fround(0.4), "Fall of the pressure by which an effort starts a breath, 0 for none"),
  setting("trigger_flow", "L/min", 0, 20, Math.fround(0.6), "Change of the flow by which an effort starts a breath, 0 for none"),
  setting("tidal_volume_low", "mL", 0, 3000, 0, "Expired volume below which an alarm is raised, 0 for none"),
  setting("tidal_volume_high", "mL", 0, 3000, 0, "Expired volume above which an alarm is raised, 0 for none"),
  setting("minute_volume_low", "L/min", 0, 60, 0, "Expired minute volume below which an alarm is raised, 0 for none"),
  setting("minute_volume_high", "L/min", 0, 60, 0, "Expired minute volume above which an alarm is raised, 0 for none"),
];

const choice = (min, max, usual) => ({ min, max, default: usual });
const MEASURE = { amplitude: choice(Math.fround(0.1), 20, 10), frequencies: choice(8, 40, 20), breaths: choice(5, 24, 6), warm_up: 6, ramp_s: 1 };

class FakeDevice {
  constructor(id, name, lung) {
    Object.assign(this, { id, name, lung, alarms: [], steerer: null, recording: null, pauseEnd: 0, connected: true, triggers: null, mode: null, safeState: false, pausing: true, mute: false, adaptation: lung.learned ? { breaths: 2, of: 4, last: "adopted" } : null, untold: false, testing: false, kind: "simulated" });
    this.settings = Object.fromEntries(SETTINGS.map((one) => [one.name, one.default]));
    this.ventilating = true;
    this.verdict = null;
    this.margins = null;
    this.measuring = null;
    this.history = null;
    this.begin = Date.now() - Math.random() * 3000;
  }

  state() {
    const open = this.alarms.filter((alarm) => !alarm.acknowledged);
    const priority = ["high", "medium", "low"].find((one) => open.some((alarm) => alarm.priority === one)) ?? null;
    const { learned } = this.lung;
    return {
      type: "state", device: this.id, connected: this.connected, lost: this.connected ? null : "the port is gone",
      missing: this.connected ? null : "line", mode: this.mode ?? (this.ventilating ? "ventilating" : "standby"), ventilating: this.ventilating, safe_state: this.safeState, controller: learned ? "learned" : "PID 3,4,0",
      level: learned ? "learned" : "pid", distrust: this.alarms.filter((alarm) => alarm.present).map((alarm) => alarm.text), adaptation: this.adaptation, settings: this.untold ? null : this.settings, pending: null,
      alarms: this.alarms, audio: { priority, pause_left: Math.max(0, Math.ceil((this.pauseEnd - Date.now()) / 1000)) },
      steered_by: this.steerer ? "a browser tab" : null, ticks: { mean_us: 14.8, worst_us: 21, bias_us: 0.05, jitter_us: 0.62, missed: 0 },
      line: { corrupt: 0, lost_batches: 0, dropped: 0 }, lease: null, triggers: this.triggers, recording: this.recording, measuring: this.measuring,
    };
  }
}

/** A flight recorder that holds a ventilation: 2 s with a gap before the last 400 ticks, and a minute. */
function recorder() {
  const settings = Object.fromEntries(SETTINGS.map((one) => [one.name, one.default]));
  const ticks = (count, stride) => {
    const lung = new Lung();
    const rows = Array.from({ length: count * stride }, () => lung.step(settings).sample).filter((_, tick) => tick % stride === stride - 1);
    const column = (place) => rows.map((sample) => sample[place]);
    return { time: rows.map((_, row) => (row + 1 - count) * stride * 1e-3), pressure: column(0), target: column(1), u_in: column(2), u_out: column(3) };
  };
  const fast = ticks(2000, 1);
  for (const [name, column] of Object.entries(fast)) column.splice(1600, 0, name === "time" ? column[1599] : null);
  const events = [{ start: 3, seconds: 0.5, text: "ventilation started" }, { start: 3, seconds: 9, text: "alarm: leak" }];
  return { events, fast, slow: ticks(3000, 20) };
}

function lungs(demo) {
  if (!demo) return [new FakeDevice(0, "Bench", new Lung())];
  const rows = [[5, 50], [20, 20], [50, 10]];
  const pairs = rows.flatMap(([resistance, compliance]) => [false, true].map((learned) => ({ resistance, compliance, learned })));
  const single = [[5, 20], [20, 50], [50, 20]].map(([resistance, compliance]) => ({ resistance, compliance, learned: true }));
  return [...pairs.map((one) => [one, one.learned ? ", learned" : ", PID"]), ...single.map((one) => [one, ""])].map(([one, tail], id) =>
    new FakeDevice(id, `R ${one.resistance} C ${one.compliance}${tail}`, new Lung(one)));
}

export class Fake {
  /** With `listen`, a page that has not shown the token is not served. */
  constructor({ steer = false, demo = false, record = true, token = null, listen = false } = {}) {
    Object.assign(this, { steer, demo, record, token, listen, stalled: false, received: [], drawn: [] });
    this.devices = lungs(demo);
  }

  async start(port = 0) {
    this.http = createServer((request, response) => this.serve(request, response));
    this.sockets = new WebSocketServer({ server: this.http, path: "/api/stream" });
    this.sockets.on("connection", (socket) => this.open(socket));
    await new Promise((resolve) => this.http.listen(port, "127.0.0.1", resolve));
    this.port = this.http.address().port;
    this.timers = [setInterval(() => this.run(), 20), setInterval(() => this.states(), 250)];
    return `http://127.0.0.1:${this.port}/`;
  }

  /** Dies as a killed process does. */
  async stop() {
    for (const timer of this.timers) clearInterval(timer);
    for (const socket of this.sockets.clients) socket.terminate();
    this.http.closeAllConnections();
    await new Promise((resolve) => this.http.close(resolve));
  }

  /** Leaves the open connections half open, as a pulled cable does: nothing comes and nothing is answered, not even a closing. */
  unplug() {
    for (const socket of this.sockets.clients) {
      socket.served = false;
      socket.watched.clear();
      socket.pause();
    }
  }

  alarm(device, id, priority, text) {
    this.devices[device].alarms.push({ id, text, priority, present: true, since_ms: Date.now(), acknowledged: false });
    this.states();
  }

  /** Ends a measurement with a result, as the server does. */
  measured(device, result) {
    Object.assign(this.devices[device], { measuring: null, margins: result });
    this.all({ type: "margins", device, ...result });
    this.states();
  }

  clear(device) {
    this.devices[device].alarms = [];
    this.states();
  }

  async serve(request, response) {
    const file = FILES[request.url];
    const headers = { "Content-Security-Policy": CSP, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cache-Control": "no-store" };
    if (!file) return response.writeHead(404, headers).end("not found");
    response.writeHead(200, { ...headers, "Content-Type": file[1] }).end(await readFile(join(DIST, file[0])));
  }

  open(socket) {
    socket.watched = new Set();
    socket.served = false;
    socket.on("message", (text) => this.take(socket, JSON.parse(text)));
    socket.on("close", () => { for (const device of this.devices) if (device.steerer === socket) this.steers(device, null); });
    if (!this.listen) this.greet(socket);
  }

  greet(socket) {
    socket.served = true;
    const devices = this.devices.map(({ id, name, kind }) => ({ id, name, kind, period_us: 1000 }));
    this.send(socket, { type: "hello", version: 1, steer: this.steer, record: this.record, demo: this.demo, settings: SETTINGS, limits: { audio_pause_s: 120, large_change: 5 }, measure: MEASURE, devices });
    for (const device of this.devices) {
      this.send(socket, device.state());
      if (device.history) this.send(socket, { type: "history", device: device.id, ...device.history });
      if (device.verdict) this.send(socket, { type: "verdict", device: device.id, ...device.verdict });
      if (device.margins) this.send(socket, { type: "margins", device: device.id, ...device.margins });
    }
  }

  send(socket, message) {
    if (!this.stalled && socket.served) socket.send(JSON.stringify(message));
  }

  all(message) {
    for (const socket of this.sockets.clients) this.send(socket, message);
  }

  steers(device, socket) {
    device.steerer = socket;
    for (const one of this.sockets.clients) this.send(one, { type: "steerer", device: device.id, who: socket ? "a browser tab" : null, yours: one === socket });
    this.all(device.state());
  }

  states() {
    for (const device of this.devices) device.alarms = device.alarms.filter(({ present, acknowledged }) => present || !acknowledged);
    for (const device of this.devices) this.all(device.state());
  }

  take(socket, message) {
    if (message.type === "drawn") return void this.drawn.push(message);
    this.received.push(message);
    if (message.type === "token" && this.token !== null && message.token !== this.token) return socket.close(1008, "wrong token");
    if (message.type === "token" && this.listen && !socket.served) this.greet(socket);
    if (message.type === "watch") socket.watched = new Set(message.devices);
    const device = this.devices[message.device];
    if (device === undefined) return;
    if (message.type === "take" && (device.steerer === null || device.steerer === socket || message.take_over)) return this.steers(device, socket);
    if (message.type === "take") return this.send(socket, { type: "steerer", device: device.id, who: "a browser tab", yours: false });
    if (message.type === "release") return this.steers(device, null);
    if (message.id !== undefined) this.answer(socket, device, message);
  }

  answer(socket, device, message) {
    const ok = device.steerer === socket || ["mark", "record", "capture", "recorder"].includes(message.type);
    if (message.type === "start" && device.testing) return;
    if (message.type === "pause_audio" && !device.pausing) return this.send(socket, { type: "answer", id: message.id, ok: false, text: "no sounder", settings: null });
    const text = ok ? this.obey(device, message) : "take control of the device first";
    this.send(socket, { type: "answer", id: message.id, ok, text, settings: device.settings });
    this.all(device.state());
  }

  obey(device, message) {
    const event = (kind, text) => this.all({ type: "event", device: device.id, time_ms: Date.now(), kind, text, tick: device.lung.tick });
    switch (message.type) {
      case "apply": for (const [name, value] of Object.entries(message.settings)) device.settings[name] = Math.fround(value); return "Applied from the next breath on.";
      case "start": device.ventilating = true; return "Ventilation started.";
      case "stop": device.ventilating = false; return "Ventilation stopped.";
      case "acknowledge": device.alarms = device.alarms.filter(({ present }) => present); for (const alarm of device.alarms) alarm.acknowledged = true; return "Acknowledged.";
      case "pause_audio": device.pauseEnd = Date.now() + 1000 * Math.min(message.seconds, 120); return "Paused.";
      case "mark": event("marker", message.text); return "Marker set.";
      case "record": device.recording = message.on ? { file: "bench-1.parquet", samples: 0, lost: 0 } : null; return message.on ? "Recording." : "Recording ended.";
      case "capture": device.triggers = Object.keys(message.triggers).length > 0 ? message.triggers : null; return device.triggers ? "Capture armed." : "Disarmed.";
      case "recorder": this.all({ type: "recorder", device: device.id, ...recorder() }); return "5000 ticks and 2 events read";
      case "measure": device.measuring = { breath: 6, breaths: 126, by: "a browser tab" }; return "the measurement has begun";
      case "stop_measuring": device.measuring = null; return "stopped";
      case "fault": return this.fault(device, message.fault);
      default: return "";
    }
  }

  fault(device, fault) {
    const { lung } = device;
    lung.fault = fault;
    if (fault === "cough") lung.coughLeft = 250;
    device.alarms = [];
    if (fault === "disconnect") this.alarm(device.id, "disconnection", "high", "Patient disconnected");
    if (fault === "stick") this.alarm(device.id, "reading-frozen", "medium", "Pressure sensor does not change");
    return fault === "none" ? "Faults cleared." : `Fault: ${fault}.`;
  }

  /** Catches up with the clock, one tick per millisecond, and sends what came. */
  run() {
    for (const device of this.devices) {
      const due = Math.min(Math.floor(Date.now() - device.begin) - device.lung.tick, 4000);
      const first = device.lung.tick;
      const samples = [];
      while (samples.length < due) {
        const { sample, breath } = device.lung.step(device.settings);
        samples.push(sample);
        if (breath) this.all({ type: "breath", device: device.id, time_ms: Date.now(), ...breath });
      }
      if (device.recording) device.recording.samples += samples.length;
      if (samples.length > 0 && !this.stalled && !device.mute && device.connected) this.sendSamples(device, first, samples);
    }
  }

  sendSamples(device, first, samples) {
    const bytes = encode(device.id, first, samples);
    for (const socket of this.sockets.clients) if (socket.watched.has(device.id)) socket.send(bytes);
  }
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const flag = (name) => process.argv.includes(name);
  const port = Number(process.argv[process.argv.indexOf("--port") + 1]) || 8080;
  console.log(await new Fake({ steer: flag("--steer"), demo: flag("--demo") }).start(port));
}
