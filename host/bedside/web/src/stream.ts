// The stream's wire format, version 1: decodes the server's messages.
//
// Text messages are JSON objects with a `type`; binary messages are samples. A message that does not decode is reported to the
// caller, which counts it; nothing here throws.

/** The version of the format that this page speaks. */
export const VERSION = 1;
/** Bytes before the columns of a message with samples. */
export const HEADER = 24;
/** Columns of 32-bit floats of a message with samples, in order. */
export const COLUMNS = ["pressure", "target", "u_in", "u_out", "learned", "flow", "volume"] as const;

export type Priority = "high" | "medium" | "low";
export type Column = (typeof COLUMNS)[number];
export type Values = Record<string, number>;

/** Description of one setting. */
export interface Setting {
  name: string;
  description: string;
  unit: string;
  min: number;
  max: number;
  default: number;
}

export interface DeviceInfo {
  id: number;
  name: string;
  kind: string;
  period_us: number;
}

export interface Hello {
  type: "hello";
  version: number;
  steer: boolean;
  /** Whether pages with the server's token may record, set markers and read a flight recorder, also without steering. */
  record: boolean;
  demo: boolean;
  settings: Setting[];
  devices: DeviceInfo[];
  /** Longest audio pause, s. */
  audio_pause_max: number;
  /** A change of a pressure by more than this needs a confirmation, cmH2O. */
  large_change: number;
  /** What a measurement of the margins may ask for; null if none can be made. */
  measure: Measure | null;
}

/** Bounds and default of a number. */
export interface Choice { min: number; max: number; default: number }

/** What a measurement of the margins may ask for: amplitude, percent; breaths before the first sine; and the length of its ramps, s. */
export interface Measure { amplitude: Choice; frequencies: Choice; breaths: Choice; warm_up: number; ramp_s: number }

export interface Alarm {
  id: string;
  text: string;
  priority: Priority;
  present: boolean;
  /** Null if it began before the server knew the device. */
  since_ms: number | null;
  acknowledged: boolean;
}

export interface State {
  type: "state";
  device: number;
  connected: boolean;
  /** The missing part of a device that is not connected. */
  missing: "line" | "answers" | "samples" | null;
  lost: string | null;
  mode: string;
  ventilating: boolean;
  /** Whether the device has latched its safe state. */
  safe_state: boolean;
  controller: string;
  level: string;
  distrust: string[];
  /** How far the learned controller has adapted to the patient; null if another one is chosen, or if it is not known. */
  adaptation: Adaptation | null;
  /** Settings in force; empty if they are not known. */
  settings: Values;
  pending: Values | null;
  alarms: Alarm[];
  audio: { priority: Priority | null; pause_left: number };
  steered_by: string | null;
  /** Times of the control ticks: work, and distance of their period from the one that is meant. */
  ticks: { mean_us: number | null; worst_us: number | null; bias_us: number | null; jitter_us: number | null; missed: number | null };
  line: { corrupt: number; lost_batches: number; dropped: number };
  recording: Recording | null;
  /** The measurement of the margins that runs. */
  measuring: Measuring | null;
  /** The program that steers the device past this server, in words. */
  lease: string | null;
  /** The armed triggers of a capture; null if none is armed or the server does not tell. */
  triggers: Triggers | null;
}

/** A running recording: `by` is the page that started it, `lost` counts the samples for which the disk was too slow. */
export interface Recording { file: string; samples: number; lost: number; by: string | null }

/** A running measurement: breaths so far and in all, and the page that started it. */
export interface Measuring { breath: number; breaths: number; by: string | null }

/** The breaths that the learned controller remembers, the number after which it has adapted, and what became of the last one. */
export interface Adaptation { breaths: number; of: number; last: string }

/** Triggers of a capture: an alarm, or an overshoot or a pressure above a level in cmH2O. */
export interface Triggers { alarm: boolean; overshoot: number | null; pressure: number | null }

/** Names of a breath's figures. */
export const FIGURES = [
  "number", "pip", "plateau", "peep", "tidal_volume", "minute_volume", "rate", "rate_set", "ie",
  "resistance", "compliance", "leak", "error", "rise_ms", "overshoot",
] as const;
export type Figure = (typeof FIGURES)[number];

export type Breath = { type: "breath"; device: number; time_ms: number | null; estimated: boolean; triggered: boolean } & Record<Figure, number | null>;

export interface Steerer { type: "steerer"; device: number; who: string | null; yours: boolean }
export interface Answer { type: "answer"; id: number; ok: boolean; text: string; settings: Values | null }
export interface Event { type: "event"; device: number; time_ms: number; kind: string; text: string; tick: number | null }

/** Lowest, mean and highest value of a figure in each minute; null where it is not known. */
export interface Course { low: (number | null)[]; mean: (number | null)[]; high: (number | null)[] }
/** The trends before this page was opened: minutes since 1970 that had breaths. */
export interface History { type: "history"; device: number; minutes: number[]; breaths: number[]; figures: Record<string, Course> }

/** A tolerance: a fixed part, and percent of the set pressure. */
export interface Tolerance { fixed: number; percent: number }
export interface LimitCheck {
  name: string; unit: string; limit: Tolerance; checked: number; violations: number; worst: number | null; worst_breath: number | null;
}
/** The verdict on a recording. */
export interface Verdict {
  type: "verdict"; device: number; refused: string | null; breaths: number; unjudged: number; violating: number;
  error: number | null; explored: number; inspiration: Tolerance | null; expiration: Tolerance | null;
  limits: LimitCheck[]; sore_spots: string[];
}

export interface LogLine { start: number; seconds: number; text: string }
/** Recorded ticks, oldest first: time, s, and what was then; all null in a gap. */
export interface Recorded { time: number[]; pressure: (number | null)[]; target: (number | null)[]; u_in: (number | null)[]; u_out: (number | null)[] }
/** The content of a flight recorder: its events, oldest first, and for a connected device its ticks. */
export interface FlightRecorder { type: "recorder"; device: number; events: LogLine[]; fast: Recorded | null; slow: Recorded | null }

/** A margin: its value is null if it is not stated, and `unstated` is the reason; `high` is null beyond the measured frequencies. */
export interface Margin {
  name: string; unit: string; value: number | null; unstated: string | null; low: number | null; high: number | null;
  decimals: number; robust: string; keeps: boolean | null;
}
/** A curve: what it stands for, as in the names of the colours, and points in the order in which they are joined. */
export interface Curve { name: string; role: string; dashed: boolean; x: number[]; y: (number | null)[] }
/** A figure; `square` are the ends of both axes of one whose circles are round. */
export interface Chart {
  title: string; x_label: string; y_label: string; log_x: boolean; log_y: boolean; square: [number, number] | null; curves: Curve[];
}
/** The margins of a device. */
export interface Margins {
  type: "margins"; device: number; time_ms: number; refused: string | null; controller: string; amplitude: number;
  margins: Margin[]; remarks: string[]; advice: { cause: string; text: string }[]; charts: Chart[];
}
export type Message = Margins | Hello | State | Breath | Steerer | Answer | Event | History | Verdict | FlightRecorder;

/** Samples of one device, columns of equal length. */
export interface Samples {
  device: number;
  count: number;
  /** Samples of this device that this viewer has lost so far because its queue was full. */
  dropped: number;
  /** Tick of the first sample. */
  tick: number;
  /** Time of the server when the last sample came, Unix ms. */
  time_ms: number;
  columns: Record<Column, Float32Array>;
  /** 0 inspiration, 1 fall, 2 expiration. */
  phase: Uint8Array;
}

/** Decodes a binary message; null if it is malformed. */
export function decodeSamples(buffer: ArrayBuffer): Samples | null {
  if (buffer.byteLength < HEADER) return null;
  const view = new DataView(buffer);
  const count = view.getUint16(2, true);
  const floats = 4 * COLUMNS.length * count;
  const length = HEADER + floats + count;
  if (view.getUint8(0) !== 1 || buffer.byteLength < length || buffer.byteLength > length + 3) return null;
  const column = (index: number) => floatsAt(view, HEADER + 4 * index * count, count);
  return {
    device: view.getUint8(1),
    count,
    dropped: view.getUint32(4, true),
    tick: view.getFloat64(8, true),
    time_ms: view.getFloat64(16, true),
    columns: {
      pressure: column(0), target: column(1), u_in: column(2), u_out: column(3),
      learned: column(4), flow: column(5), volume: column(6),
    },
    phase: new Uint8Array(buffer, HEADER + floats, count),
  };
}

const LITTLE = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;

function floatsAt(view: DataView, offset: number, count: number): Float32Array {
  if (LITTLE) return new Float32Array(view.buffer, offset, count);
  return Float32Array.from({ length: count }, (_, index) => view.getFloat32(offset + 4 * index, true));
}

/** Decodes a text message; null if it is malformed or of an unknown type. */
export function decodeText(text: string): Message | null {
  let value: unknown;
  try {
    value = JSON.parse(text);
  } catch {
    return null;
  }
  if (!isObject(value)) return null;
  switch (value.type) {
    case "hello": return hello(value);
    case "state": return state(value);
    case "breath": return breath(value);
    case "steerer": return { type: "steerer", device: number(value.device) ?? 0, who: textOrNull(value.who), yours: value.yours === true };
    case "answer": return {
      type: "answer", id: number(value.id) ?? -1, ok: value.ok === true, text: string(value.text),
      settings: isObject(value.settings) ? values(value.settings) : null,
    };
    case "event": return {
      type: "event", device: number(value.device) ?? 0, time_ms: number(value.time_ms) ?? Date.now(),
      kind: string(value.kind), text: string(value.text), tick: number(value.tick),
    };
    case "history": return history(value);
    case "verdict": return verdict(value);
    case "margins": return margins(value);
    case "recorder": return {
      type: "recorder", device: number(value.device) ?? 0, fast: recorded(value.fast), slow: recorded(value.slow),
      events: list(value.events).map((one) => ({ start: number(one.start) ?? 0, seconds: number(one.seconds) ?? 0, text: string(one.text) })),
    };
    default: return null;
  }
}

type Loose = Record<string, unknown>;

function isObject(value: unknown): value is Loose {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

function number(value: unknown): number | null {
  return typeof value === "number" && Number.isFinite(value) ? value : null;
}

function string(value: unknown): string {
  return typeof value === "string" ? value : "";
}

function textOrNull(value: unknown): string | null {
  return typeof value === "string" && value !== "" ? value : null;
}

function list(value: unknown): Loose[] {
  return Array.isArray(value) ? value.filter(isObject) : [];
}

function object(value: unknown): Loose {
  return isObject(value) ? value : {};
}

function values(of: Loose): Values {
  return Object.fromEntries(Object.entries(of).filter((entry): entry is [string, number] => number(entry[1]) !== null));
}

function priority(value: unknown): Priority | null {
  return value === "high" || value === "medium" || value === "low" ? value : null;
}

function hello(value: Loose): Hello {
  const limits = object(value.limits);
  return {
    type: "hello",
    version: number(value.version) ?? 0,
    steer: value.steer === true,
    record: value.record === true,
    demo: value.demo === true,
    settings: list(value.settings).map((one) => ({
      name: string(one.name), description: string(one.description), unit: string(one.unit),
      min: number(one.min) ?? 0, max: number(one.max) ?? 0, default: number(one.default) ?? 0,
    })),
    devices: list(value.devices).map((one) => ({
      id: number(one.id) ?? 0, name: string(one.name), kind: string(one.kind), period_us: number(one.period_us) ?? 1000,
    })),
    // Without a limit there is no pause, and each change is confirmed.
    audio_pause_max: number(limits.audio_pause_s) ?? 0,
    large_change: number(limits.large_change) ?? 0,
    measure: measure(value.measure),
  };
}

function measure(value: unknown): Measure | null {
  if (!isObject(value)) return null;
  const choice = (of: unknown): Choice => {
    const { min, max, default: usual } = object(of);
    return { min: number(min) ?? 0, max: number(max) ?? 0, default: number(usual) ?? 0 };
  };
  return {
    amplitude: choice(value.amplitude), frequencies: choice(value.frequencies), breaths: choice(value.breaths),
    warm_up: number(value.warm_up) ?? 0, ramp_s: number(value.ramp_s) ?? 0,
  };
}

function alarm(value: Loose): Alarm {
  return {
    id: string(value.id), text: string(value.text),
    // An unknown priority is treated as the most urgent one.
    priority: priority(value.priority) ?? "high",
    present: value.present === true, since_ms: number(value.since_ms), acknowledged: value.acknowledged === true,
  };
}

function state(value: Loose): State | null {
  const device = number(value.device);
  if (device === null) return null;
  const [audio, ticks, line] = [object(value.audio), object(value.ticks), object(value.line)];
  return {
    type: "state",
    device,
    connected: value.connected === true,
    missing: value.missing === "line" || value.missing === "answers" || value.missing === "samples" ? value.missing : null,
    lost: textOrNull(value.lost),
    mode: string(value.mode),
    ventilating: value.ventilating === true,
    safe_state: value.safe_state === true,
    controller: string(value.controller),
    level: string(value.level),
    distrust: Array.isArray(value.distrust) ? value.distrust.map(string) : [],
    adaptation: adaptation(value.adaptation),
    settings: values(object(value.settings)),
    pending: isObject(value.pending) ? values(value.pending) : null,
    alarms: list(value.alarms).map(alarm),
    audio: { priority: priority(audio.priority), pause_left: number(audio.pause_left) ?? 0 },
    steered_by: textOrNull(value.steered_by),
    ticks: {
      mean_us: number(ticks.mean_us), worst_us: number(ticks.worst_us), bias_us: number(ticks.bias_us), jitter_us: number(ticks.jitter_us),
      missed: number(ticks.missed),
    },
    line: { corrupt: number(line.corrupt) ?? 0, lost_batches: number(line.lost_batches) ?? 0, dropped: number(line.dropped) ?? 0 },
    recording: recording(value.recording),
    measuring: measuring(value.measuring),
    lease: textOrNull(value.lease),
    triggers: triggers(value.triggers),
  };
}

function recording(value: unknown): Recording | null {
  if (!isObject(value)) return null;
  return { file: string(value.file), samples: number(value.samples) ?? 0, lost: number(value.lost) ?? 0, by: textOrNull(value.by) };
}

function measuring(value: unknown): Measuring | null {
  if (!isObject(value)) return null;
  return { breath: number(value.breath) ?? 0, breaths: number(value.breaths) ?? 0, by: textOrNull(value.by) };
}

function adaptation(value: unknown): Adaptation | null {
  if (!isObject(value)) return null;
  const [breaths, of] = [number(value.breaths), number(value.of)];
  return breaths === null || of === null ? null : { breaths, of, last: string(value.last) };
}

function triggers(value: unknown): Triggers | null {
  if (!isObject(value)) return null;
  const found = { alarm: value.alarm === true, overshoot: number(value.overshoot), pressure: number(value.pressure) };
  return found.alarm || found.overshoot !== null || found.pressure !== null ? found : null;
}

/** Columns of unequal length do not decode. */
function history(value: Loose): History | null {
  const [minutes, breaths] = [numbers(value.minutes), numbers(value.breaths)];
  if (minutes.length !== breaths.length || minutes.includes(null) || breaths.includes(null)) return null;
  const figures: Record<string, Course> = {};
  for (const [name, one] of Object.entries(object(value.figures))) {
    const { low, mean, high } = object(one);
    const course = { low: numbers(low), mean: numbers(mean), high: numbers(high) };
    if (Object.values(course).some((column) => column.length !== minutes.length)) return null;
    figures[name] = course;
  }
  return { type: "history", device: number(value.device) ?? 0, minutes: minutes as number[], breaths: breaths as number[], figures };
}

function numbers(value: unknown): (number | null)[] {
  return Array.isArray(value) ? value.map(number) : [];
}

/** Recorded ticks; null if there are none or their columns do not fit. */
function recorded(value: unknown): Recorded | null {
  const { time, pressure, target, u_in, u_out } = object(value);
  const [times, ...columns] = [numbers(time), numbers(pressure), numbers(target), numbers(u_in), numbers(u_out)] as const;
  if (times.length === 0 || times.includes(null) || columns.some(({ length }) => length !== times.length)) return null;
  return { time: times as number[], pressure: columns[0], target: columns[1], u_in: columns[2], u_out: columns[3] };
}

function tolerance(value: unknown): Tolerance | null {
  return isObject(value) ? { fixed: number(value.fixed) ?? 0, percent: number(value.percent) ?? 0 } : null;
}

function verdict(value: Loose): Verdict {
  return {
    type: "verdict", device: number(value.device) ?? 0, refused: textOrNull(value.refused),
    breaths: number(value.breaths) ?? 0, unjudged: number(value.unjudged) ?? 0, violating: number(value.violating) ?? 0,
    error: number(value.error), explored: number(value.explored) ?? 0,
    inspiration: tolerance(value.inspiration), expiration: tolerance(value.expiration),
    limits: list(value.limits).map((one) => ({
      name: string(one.name), unit: string(one.unit), limit: tolerance(one.limit) ?? { fixed: 0, percent: 0 },
      checked: number(one.checked) ?? 0, violations: number(one.violations) ?? 0,
      worst: number(one.worst), worst_breath: number(one.worst_breath),
    })),
    sore_spots: Array.isArray(value.sore_spots) ? value.sore_spots.map(string) : [],
  };
}

function margins(value: Loose): Margins {
  const texts = (of: unknown) => (Array.isArray(of) ? of.map(string) : []);
  return {
    type: "margins", device: number(value.device) ?? 0, time_ms: number(value.time_ms) ?? 0, refused: textOrNull(value.refused),
    controller: string(value.controller), amplitude: number(value.amplitude) ?? 0,
    margins: list(value.margins).map((one) => ({
      name: string(one.name), unit: string(one.unit), value: number(one.value), unstated: textOrNull(one.unstated),
      low: number(one.low), high: number(one.high), decimals: number(one.decimals) ?? 2, robust: string(one.robust),
      keeps: typeof one.keeps === "boolean" ? one.keeps : null,
    })),
    remarks: texts(value.remarks),
    advice: list(value.advice).map(({ cause, text }) => ({ cause: string(cause), text: string(text) })),
    charts: list(value.charts).map(chart),
  };
}

function chart(value: Loose): Chart {
  const [low, high] = numbers(value.square);
  return {
    title: string(value.title), x_label: string(value.x_label), y_label: string(value.y_label),
    log_x: value.log_x === true, log_y: value.log_y === true, square: low == null || high == null ? null : [low, high],
    curves: list(value.curves).map(({ name, role, dashed, x, y }) => {
      const values = numbers(y);
      const known = numbers(x).flatMap((one, place) => (one === null ? [] : [[one, values[place] ?? null] as const]));
      return { name: string(name), role: string(role), dashed: dashed === true, x: known.map(([one]) => one), y: known.map(([, one]) => one) };
    }),
  };
}

function breath(value: Loose): Breath | null {
  const device = number(value.device);
  if (device === null) return null;
  const figures = Object.fromEntries(FIGURES.map((name) => [name, number(value[name])])) as Record<Figure, number | null>;
  return { type: "breath", device, time_ms: number(value.time_ms), estimated: value.estimated !== false, triggered: value.triggered === true, ...figures };
}
