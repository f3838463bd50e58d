//! The lung of a unit behind its circuit: an implicit step for the pressure at the junction of all flows.
//!
//! ```text
//! Cc dp/dt = F w sqrt(1 - p/S) - e g_e (p - PEEP) - g_l p - q      airway pressure p, opening e of the closing expiratory valve
//! C  da/dt = q,  p - a = R q (1 + k |q|)                          alveolar pressure a
//! ```

use super::LUNG;
use crate::simulator::{BreathStart, branch};
use engine::{LANES, Lane};

pub(super) const RESISTANCE: usize = 0;
pub(super) const TURBULENCE: usize = 1;
pub(super) const COMPLIANCE: usize = 2;
pub(super) const LEAK: usize = 3;
pub(super) const CIRCUIT: usize = 4;
pub(super) const CLOSING: usize = 5;
pub(super) const ORIFICE: usize = 6;
pub(super) const SENSOR: usize = 7;
pub(super) const OUTWARD: usize = 8;
pub(super) const ML_PER_L: f32 = 1e3;
const MS_PER_S: f32 = 1e3;
/// Linear and square part of a leak of one L/s at 30 cmH2O.
pub(super) const LEAK_PARTS: (f32, f32) = (0.6, 29.4);
/// Linear part of the expiratory valve, cmH2O/(L/s).
pub(super) const EXPIRATORY_LINEAR: f32 = 0.5;
/// Smallest drive of the supply, as a share of its pressure.
pub(super) const LEAST_DRIVE: f32 = 0.01;

/// The lungs of a shard.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LungLanes {
    numbers: [Lane; LUNG],
    /// Rise of the alveolar pressure by 1 L/s in a tick, cmH2O.
    rise: Lane,
    /// Conductance that represents the circuit's compliance, (L/s)/cmH2O.
    keep: Lane,
    /// Share of the expiratory opening that is left after a tick.
    closing: Lane,
    /// Share of the way to the pressure that the sensor moves in a tick.
    sensor: Lane,
    /// Inspiratory and expiratory time, s.
    times: [f32; 2],
}

impl LungLanes {
    pub fn new(numbers: &[Lane; LUNG], tick_s: f32, times: [f32; 2]) -> Self {
        Self {
            numbers: *numbers,
            rise: numbers[COMPLIANCE].map(|c| ML_PER_L * tick_s / c),
            keep: numbers[CIRCUIT].map(|c| c / (ML_PER_L * tick_s)),
            closing: numbers[CLOSING].map(|lag| (-MS_PER_S * tick_s / lag).exp()),
            sensor: numbers[SENSOR].map(|lag| 1.0 - (-MS_PER_S * tick_s / lag).exp()),
            times,
        }
    }

    /// Share of the last plateau above PEEP that is still in the lung, with its slopes by the logarithms of R, C and the
    /// expiratory path's resistance: filled through R, emptied through both.
    fn left(&self, l: usize) -> [f32; 4] {
        let [inspiration, expiration] = self.times;
        let lung = [RESISTANCE, COMPLIANCE, OUTWARD].map(|n| self.numbers[n][l]);
        let [r, _, out] = lung;
        let ([filling, emptying], [x, y]) = unfilled_and_left(self.times, lung);
        let rest = 1.0 - x * y;
        let by_x = -y * (1.0 - y) / (rest * rest) * x * inspiration / filling;
        let by_y = (1.0 - x) / (rest * rest) * y * expiration / emptying;
        [left_in_lung(self.times, lung), by_x + by_y * r / (r + out), by_x + by_y, by_y * out / (r + out)]
    }
}

/// Time constants of inspiration and expiration, s, and the shares of their way that are missing at their ends, for R, C and the
/// resistance of the expiratory path.
fn unfilled_and_left([inspiration, expiration]: [f32; 2], [r, c, out]: [f32; 3]) -> ([f32; 2], [f32; 2]) {
    let (filling, emptying) = (r * c / ML_PER_L, (r + out) * c / ML_PER_L);
    ([filling, emptying], [(-inspiration / filling).exp(), (-expiration / emptying).exp()])
}

/// Share of the last plateau above PEEP that is still in the lung, for inspiratory and expiratory time, s, and a lung's R, C and
/// resistance of the expiratory path.
pub(super) fn left_in_lung(times: [f32; 2], lung: [f32; 3]) -> f32 {
    let (_, [x, y]) = unfilled_and_left(times, lung);
    (1.0 - x) * y / (1.0 - x * y)
}

/// State and flows of one tick.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    pressure: Lane,
    alveolar: Lane,
    sensed: Lane,
    /// Opening of the expiratory valve.
    opening: Lane,
    next: Lane,
}

/// Forward values and backward gradients of a rollout.
#[derive(Clone, Debug)]
pub(super) struct LungTape {
    lanes: LungLanes,
    steps: Vec<Step>,
    now: Step,
    peep: Lane,
    above_peep: Lane,
    d_pressure: Lane,
    d_alveolar: Lane,
    d_sensed: Lane,
    d_opening: Lane,
    d: [Lane; LUNG],
}

impl LungTape {
    pub fn new(ticks: usize) -> Self {
        Self {
            lanes: LungLanes::default(),
            steps: vec![Step::default(); ticks],
            now: Step::default(),
            peep: Lane::ZERO,
            above_peep: Lane::ZERO,
            d_pressure: Lane::ZERO,
            d_alveolar: Lane::ZERO,
            d_sensed: Lane::ZERO,
            d_opening: Lane::ZERO,
            d: [Lane::ZERO; LUNG],
        }
    }

    pub fn begin(&mut self, lanes: &LungLanes, start: &BreathStart) {
        self.lanes = *lanes;
        self.peep = start.peep;
        self.above_peep = start.plateau.zip(&start.peep, |plateau, peep| plateau - peep);
        let alveolar = Lane::from_fn(|l| self.peep[l] + self.above_peep[l] * lanes.left(l)[0]);
        self.now = Step {
            pressure: start.pressure,
            sensed: start.pressure,
            alveolar,
            opening: Lane::splat(1.0),
            next: Lane::ZERO,
        };
        (self.d_pressure, self.d_alveolar) = (Lane::ZERO, Lane::ZERO);
        (self.d_sensed, self.d_opening) = (Lane::ZERO, Lane::ZERO);
        self.d = [Lane::ZERO; LUNG];
    }

    /// Runs one tick with the valve's opening; returns the sensed pressure after it, cmH2O.
    pub fn step(&mut self, tick: usize, opening: &Lane, full_flow: &Lane, supply: &Lane) -> Lane {
        let now = &mut self.now;
        now.opening = now.opening.zip(&self.lanes.closing, |e, left| e * left);
        let mut after = *now;
        for l in 0..LANES {
            let flows = Flows::at(&self.lanes, now, self.peep[l], l);
            let inflow = full_flow[l] * opening[l] * drive(now.pressure[l], supply[l]).0;
            let next = flows.next(&self.lanes, now, self.peep[l], inflow, l);
            now.next[l] = next;
            after.pressure[l] = next;
            after.alveolar[l] =
                now.alveolar[l] + self.lanes.rise[l] * flows.lung.0 * (next - now.alveolar[l]);
            after.sensed[l] = now.sensed[l] + self.lanes.sensor[l] * (next - now.sensed[l]);
        }
        self.steps[tick] = *now;
        self.now = after;
        after.sensed
    }

    /// Backward pass of [`Self::step`]; returns the gradients with respect to the opening and the logarithms of full flow and
    /// supply.
    pub fn step_back(
        &mut self,
        tick: usize,
        opening: &Lane,
        full_flow: &Lane,
        supply: &Lane,
        d_sensed: &Lane,
    ) -> [Lane; 3] {
        self.d_sensed.add_scaled(1.0, d_sensed);
        let mut d = [Lane::ZERO; 3];
        for l in 0..LANES {
            let d_inflow = self.lane_back(
                tick,
                l,
                full_flow[l] * opening[l] * drive(self.steps[tick].pressure[l], supply[l]).0,
            );
            let (share, slope) = drive(self.steps[tick].pressure[l], supply[l]);
            let flow = full_flow[l] * opening[l];
            d[0][l] = d_inflow * full_flow[l] * share;
            d[1][l] = d_inflow * flow * share;
            self.d_pressure[l] += d_inflow * flow * slope;
            // The drive depends on p / S.
            d[2][l] = -d_inflow * flow * slope * self.steps[tick].pressure[l];
        }
        if tick == 0 {
            self.start_back();
        }
        d
    }

    /// One lane: turns the gradients after the tick into those before it; returns that with respect to the inflow.
    fn lane_back(&mut self, tick: usize, l: usize, inflow: f32) -> f32 {
        let (step, lanes, peep) = (&self.steps[tick], &self.lanes, self.peep[l]);
        let flows = Flows::at(lanes, step, peep, l);
        let (p, a, next) = (step.pressure[l], step.alveolar[l], step.next[l]);
        let total = flows.total(lanes, l);
        debug_assert!((flows.next(lanes, step, peep, inflow, l) - next).abs() < 1e-3);
        // sensor
        let d_sensed = self.d_sensed[l];
        let mut d_next = self.d_pressure[l] + lanes.sensor[l] * d_sensed;
        let left = 1.0 - lanes.sensor[l];
        self.d[SENSOR][l] += d_sensed * (next - step.sensed[l]) * left * left.ln();
        self.d_sensed[l] = left * d_sensed;
        // alveolar pressure
        let d_flow = lanes.rise[l] * self.d_alveolar[l];
        let (g, slopes) = flows.lung;
        let mut d_g = d_flow * (next - a);
        let mut d_rise = self.d_alveolar[l] * g * (next - a) * lanes.rise[l];
        d_next += d_flow * g;
        let mut d_a = self.d_alveolar[l] - d_flow * g;
        // junction
        let d_sum = d_next / total;
        let mut d_p = lanes.keep[l] * d_sum;
        self.d[CIRCUIT][l] += d_sum * (p - next) * lanes.keep[l];
        d_g += d_sum * (a - next);
        d_a += d_sum * g;
        // lung: linear = R + rise, square = R k, difference p - a
        let [by_linear, by_square, by_difference] = slopes.map(|slope| slope * d_g);
        let [r, k] = [RESISTANCE, TURBULENCE].map(|n| lanes.numbers[n][l]);
        self.d[RESISTANCE][l] += by_linear * r + by_square * r * k;
        self.d[TURBULENCE][l] += by_square * r * k;
        d_rise += by_linear * lanes.rise[l];
        d_p += by_difference;
        d_a -= by_difference;
        // The rise per tick falls as the compliance grows.
        self.d[COMPLIANCE][l] -= d_rise;
        // leak
        let (leak, slopes) = flows.leak;
        let size = lanes.numbers[LEAK][l];
        self.d[LEAK][l] -= d_sum * next * leak * size;
        d_p -= d_sum * next * size * slopes[2];
        // expiratory valve
        let (outlet, slopes) = flows.outlet;
        let d_outlet = d_sum * (peep - next) * step.opening[l];
        let square = expiratory_square(lanes, l);
        self.d[ORIFICE][l] -= 2.0 * d_outlet * slopes[1] * square;
        d_p += d_outlet * slopes[2];
        let d_opening = self.d_opening[l] + d_sum * (peep - next) * outlet;
        // opening' = opening * closing, closing = exp(-tick / lag)
        self.d[CLOSING][l] -= d_opening * step.opening[l] * lanes.closing[l].ln();
        self.d_opening[l] = d_opening * lanes.closing[l];
        (self.d_pressure[l], self.d_alveolar[l]) = (d_p, d_a);
        d_sum
    }

    /// Gradient of the alveolar pressure at the start.
    fn start_back(&mut self) {
        for l in 0..LANES {
            let [_, by_r, by_c, by_out] = self.lanes.left(l);
            let d = self.d_alveolar[l] * self.above_peep[l];
            self.d[RESISTANCE][l] += d * by_r;
            self.d[COMPLIANCE][l] += d * by_c;
            self.d[OUTWARD][l] += d * by_out;
        }
    }

    /// Gradients with respect to the logarithms of the numbers.
    pub fn gradient(&self) -> [Lane; LUNG] {
        self.d
    }
}

/// Conductances of a tick in one lane, (L/s)/cmH2O, each with its slopes by linear part, square part and difference.
struct Flows {
    lung: (f32, [f32; 3]),
    /// Of the fully open expiratory valve.
    outlet: (f32, [f32; 3]),
    expiratory: f32,
    /// Of a leak of one L/s at 30 cmH2O.
    leak: (f32, [f32; 3]),
    leaking: f32,
}

impl Flows {
    fn at(lanes: &LungLanes, step: &Step, peep: f32, l: usize) -> Self {
        let [r, k] = [RESISTANCE, TURBULENCE].map(|n| lanes.numbers[n][l]);
        let p = step.pressure[l];
        let lung = conductance(r + lanes.rise[l], r * k, p - step.alveolar[l]);
        let outlet = if p > peep {
            conductance(EXPIRATORY_LINEAR, expiratory_square(lanes, l), p - peep)
        } else {
            (0.0, [0.0; 3])
        };
        let leak = conductance(LEAK_PARTS.0, LEAK_PARTS.1, p);
        let (expiratory, leaking) = (step.opening[l] * outlet.0, lanes.numbers[LEAK][l] * leak.0);
        Self { lung, outlet, expiratory, leak, leaking }
    }

    fn total(&self, lanes: &LungLanes, l: usize) -> f32 {
        lanes.keep[l] + self.lung.0 + self.expiratory + self.leaking
    }

    /// Pressure after the tick, cmH2O.
    fn next(&self, lanes: &LungLanes, step: &Step, peep: f32, inflow: f32, l: usize) -> f32 {
        let sum = lanes.keep[l] * step.pressure[l]
            + inflow
            + self.expiratory * peep
            + self.lung.0 * step.alveolar[l];
        sum / self.total(lanes, l)
    }
}

fn expiratory_square(lanes: &LungLanes, l: usize) -> f32 {
    let orifice = lanes.numbers[ORIFICE][l];
    1.0 / (orifice * orifice)
}

/// Conductance of a parabolic resistor at a pressure difference, and its slopes by linear part, square part and difference.
fn conductance(linear: f32, square: f32, difference: f32) -> (f32, [f32; 3]) {
    let size = difference.abs();
    let (g, root) = branch::conductance(linear, square, size);
    let by_sum = -0.5 * g * g;
    let by_difference = by_sum * 2.0 * square / root * difference.signum();
    (g, [by_sum * (1.0 + linear / root), by_sum * 2.0 * size / root, by_difference])
}

/// Share of the full flow against a pressure, and its slope by the pressure.
fn drive(pressure: f32, supply: f32) -> (f32, f32) {
    let rest = 1.0 - pressure / supply;
    if rest > LEAST_DRIVE { (rest.sqrt(), -0.5 / (supply * rest.sqrt())) } else { (LEAST_DRIVE.sqrt(), 0.0) }
}
