// Results of measurements for the fake server: an integrator behind a dead time, whose margins are known.

const [GAIN, DEAD_S] = [20, 0.025];

/** Loop gain at a frequency in Hz: real and imaginary part. */
function loop(hz) {
  const omega = 2 * Math.PI * hz;
  const angle = -Math.PI / 2 - omega * DEAD_S;
  return [(GAIN / omega) * Math.cos(angle), (GAIN / omega) * Math.sin(angle)];
}

const curve = (name, x, y, more = {}) => ({ name, role: "", dashed: false, x, y, ...more });
const chart = (title, x_label, y_label, curves, more = {}) => ({ title, x_label, y_label, log_x: false, log_y: false, square: null, curves, ...more });

function circle(name, centre, radius, more) {
  const turns = Array.from({ length: 61 }, (_, place) => (place * 2 * Math.PI) / 60);
  return curve(name, turns.map((turn) => centre + radius * Math.cos(turn)), turns.map((turn) => radius * Math.sin(turn)), { dashed: true, ...more });
}

function charts() {
  const hz = Array.from({ length: 20 }, (_, place) => 1.6 * 15.6 ** (place / 19));
  const points = hz.map(loop);
  const angle = hz.map((one) => -90 - 360 * one * DEAD_S);
  const time = Array.from({ length: 1000 }, (_, tick) => tick / 333);
  const target = time.map((one) => (one < 1 ? 5 + 15 * one : Math.max(5, 20 - 30 * (one - 1))));
  return [
    chart("Loop gain", "real part", "imaginary part", [
      circle("abs(L) = 1", 0, 1), circle("Ms = 2", -1, 0.5, { role: "limit" }), curve("loop", points.map(([re]) => re), points.map(([, im]) => im)),
    ], { square: [-2.5, 1.5] }),
    chart("Magnitude", "frequency, Hz", "magnitude", [
      curve("loop", hz, points.map((one) => Math.hypot(...one))), curve("plant, cmH2O per percent", hz, hz.map((one) => 0.4 / one)),
    ], { log_x: true, log_y: true }),
    chart("Angle", "frequency, Hz", "angle, degrees", [curve("loop", hz, angle), curve("plant", hz, angle.map((one) => one - 20))], { log_x: true }),
    chart("A breath without a sine", "time, s", "pressure, cmH2O", [
      curve("target", time, target, { role: "target", dashed: true }), curve("pressure", time, target.map((_, tick) => target[Math.max(0, tick - 15)]), { role: "pressure" }),
    ]),
    chart("The valve's effort", "time, s", "command, percent", [curve("command", time, time.map((one) => (one < 1 ? 30 + 10 * one : 0)), { role: "valve" })]),
  ];
}

const margin = (name, unit, value, low, high, decimals, robust, keeps, unstated = null) => ({ name, unit, value, unstated, low, high, decimals, robust, keeps });

/** A whole result, one of whose margins is not sure. */
export const result = () => ({
  time_ms: Date.now(), refused: null, controller: "PID 3,4,0", amplitude: 10,
  margins: [
    margin("Ms", "", 2.34, 2.21, 2.5, 2, "at most 2", false),
    margin("gain margin", "", 2.51, 2.41, 2.59, 2, "at least 2", true),
    margin("delay margin", "ms", null, 31.2, null, 1, "at least 10", null, "not enough coherence"),
  ],
  remarks: ["18 of 20 frequencies count, 1.6 to 18.7 Hz, with a coherence of at least 0.84", "measured at 14.1 cmH2O and 31 % of the command; without a sine the valve moves 22 % a second", "crossover 3.2 Hz", "the device gets the settings of before again"],
  advice: [{ cause: "gain", text: "the gain is too high: Ms is 2.34 at 7.1 Hz, at most 2 is robust; at 85 % of these gains the gain margin would be 2" }],
  charts: charts(),
});

/** A result with nothing but a reason. */
export const refused = (why) => ({ time_ms: Date.now(), refused: why, controller: "PID 3,4,0", amplitude: 10, margins: [], remarks: ["the device gets the settings of before again"], advice: [], charts: [] });
