//! One simulator for many lungs: a learned ventilator that blows into a lung known by its nominal R and C.
//!
//! The ventilator sees commands alone: filters of past commands, bent by static curves, give two openings, one towards a
//! supply of constant pressure and one towards the room. It has no memory beyond its filters: one that has can tell a
//! test run by its commands, and learns runs in place of a ventilator. The lung is physics: a parabolic resistor, a
//! compliance, and the circuit's compliance between both.
//!
//! ```text
//! c'   = a c + (1 - a) (W1 v + b1)       valve: filters of past commands v, a = sigmoid(decay)
//! z    = softsign(W2 c' + b2)            their static curves
//! A, B = sigmoid(W3 [c', z] + b3)        openings, up to a bound
//! Cc dp/dt = A sqrt(S - p) - B sqrt(p) - q    airway pressure p under a supply S, an implicit step
//! C  da/dt = q                           alveolar pressure a
//! p - a    = R1 q + R2 q |q|             R1, R2 in proportion to the nominal R
//! ```
//!
//! Since nothing of the ventilator knows the lung and nothing of the lung knows the command, a lung that no breath of
//! the recording had is a new pair of numbers, not a guess. Commands of a closed loop tell the pressure to anything that
//! sees enough of them; a source that can only blow into a lung has little use for that.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{CommandLog, Dynamics, PRESSURE_SCALE, Start, Timing};
use crate::engine::Lane;
use crate::engine::activation::Activation;
use crate::engine::dense::{Dense, DenseWeights};

/// What is known at the start of a breath: pressure and command before it, and at the end of the last inspiration.
const START_INPUTS: usize = 4;
/// Numbers made of these that the static curves see during the whole breath: how the valves stand today. Valves drift
/// from run to run, and two equilibria, before the breath and at the last plateau, tell by how much.
const CALIBRATION: usize = 2;
/// What the network gives: the openings towards the supply and towards the room.
const SOURCE: usize = 2;
/// Parameters of the lung: see [`Physics`].
const PHYSICS: usize = 6;
/// Deviations of a group from what all have in common, as logarithms: R, C, opening towards the supply, opening towards
/// the room. A run whose resistor is not what its label says keeps that to itself; a lung that was never seen has none.
const DEVIATIONS: usize = 4;
/// R at which R1 and R2 are what they are, cmH2O/(L/s).
const NOMINAL: f32 = 20.0;
/// Bound of an opening, L/s per root of cmH2O.
const MOST_OPENING: f32 = 0.6;
/// Opening where the network says nothing, as the sigmoid's argument: a fifth of the bound.
const USUAL_OPENING: f32 = -1.4;
/// Pressure drop below which the resistor's root is rounded off, cmH2O.
const ROUNDING: f32 = 0.05;
const ML_PER_L: f32 = 1000.0;
/// Slowest filter of the ventilator to start with, s.
const LONGEST_FILTER_S: f32 = 0.2;

/// Shape of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HybridConfig {
    /// How time is cut.
    pub timing: Timing,
    /// States of the ventilator.
    pub states: usize,
    /// Hidden units.
    pub hidden: usize,
    /// Blocks of past commands that a step sees.
    pub history: usize,
    /// Groups (test runs) of the recording, each with deviations of its own.
    #[serde(default)]
    pub groups: usize,
}

impl HybridConfig {
    /// The default shape for a control period in microseconds and so many command channels.
    pub fn for_period(period_us: u32, channels: usize) -> Self {
        Self { timing: Timing::for_period(period_us, channels), states: 8, hidden: 24, history: 8, groups: 0 }
    }

    fn commands(&self) -> usize {
        self.history * self.timing.width()
    }

    /// Layers (filters, curves, source, start), index of the decays, number of parameters; physics and deviations come last.
    fn layout(&self) -> ([Dense; 4], usize, usize) {
        let (layers, decay) = Dense::layout([
            (self.commands(), self.states),
            (self.states + CALIBRATION, self.hidden),
            (self.states + self.hidden, SOURCE),
            (START_INPUTS, self.states + CALIBRATION),
        ]);
        (layers, decay, decay + self.states + PHYSICS + self.groups * DEVIATIONS)
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.layout().2
    }

    /// Draws parameters: time constants from one block to `LONGEST_FILTER_S`, and a plain lung.
    pub fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let ([filters, curves, source, start], decay, total) = self.layout();
        let mut parameters = vec![0.0; total];
        filters.initialise(&mut parameters, 1.0, rng);
        curves.initialise(&mut parameters, 1.0, rng);
        source.initialise(&mut parameters, 0.5, rng);
        start.initialise(&mut parameters, 0.3, rng);
        let block = self.timing.block_ticks as f32 * self.timing.period_us as f32 * 1e-6;
        for (n, decay) in parameters[decay..decay + self.states].iter_mut().enumerate() {
            let share = n as f32 / (self.states - 1).max(1) as f32;
            *decay = share * (LONGEST_FILTER_S / block).max(1.0).ln();
        }
        let physics = decay + self.states;
        parameters[physics..physics + PHYSICS].copy_from_slice(&Physics::PLAIN);
        parameters
    }
}

/// What is learned of the lungs and the circuit.
#[derive(Clone, Copy, Debug)]
struct Physics {
    /// Logarithms of R1 (cmH2O/(L/s)) and R2 (cmH2O/(L/s)^2) at the nominal R of 20. Both go with the nominal R; powers of
    /// their own, learned from a handful of lungs, were no law that held for the next.
    linear: f32,
    square: f32,
    /// Logarithm of what the nominal C is multiplied by.
    compliance: f32,
    /// Logarithm of the circuit's compliance, mL/cmH2O.
    circuit: f32,
    /// Share of the last plateau that is still in the lung.
    left: f32,
    /// Logarithm of the supply's pressure, cmH2O.
    supply: f32,
}

impl Physics {
    /// Half of the nominal drop linear, half turbulent at one litre per second; a circuit of 1.5 mL/cmH2O; a
    /// supply of 60 cmH2O.
    const PLAIN: [f32; PHYSICS] = [2.1, 2.3, 0.0, 0.4, 0.0, 4.1];

    fn new(p: &[f32]) -> Self {
        Self { linear: p[0], square: p[1], compliance: p[2], circuit: p[3], left: p[4], supply: p[5] }
    }
}

/// The lungs of a shard.
#[derive(Clone, Copy, Debug, Default)]
struct Lungs {
    linear: Lane,
    square: Lane,
    /// Pressure per flow and step: what one L/s for a step adds, cmH2O.
    rise: Lane,
    /// The circuit's conductance to its own past, (L/s)/cmH2O.
    keep: f32,
    /// Pressure of the supply, cmH2O.
    supply: f32,
    /// What the openings are multiplied by.
    openings: [Lane; SOURCE],
}

/// Gradients by the logarithms of what [`Lungs`] holds.
#[derive(Clone, Copy, Debug, Default)]
struct LungGradients {
    linear: Lane,
    square: Lane,
    rise: Lane,
    keep: Lane,
    supply: Lane,
    openings: [Lane; SOURCE],
}

/// One step of the lung, kept for the way back.
#[derive(Clone, Copy, Debug, Default)]
struct Flow {
    pressure: Lane,
    alveolar: Lane,
    conductance: Lane,
    next: Lane,
}

/// The model with its parameters, ready to run.
#[derive(Clone, Debug)]
pub struct Hybrid {
    config: HybridConfig,
    filters: DenseWeights,
    curves: DenseWeights,
    source: DenseWeights,
    start: DenseWeights,
    physics: Physics,
    deviations: Vec<[f32; DEVIATIONS]>,
    decay_offset: usize,
    /// `a` of each state.
    keep: Vec<f32>,
}

/// Forward values and backward gradients of a rollout, block after block.
#[derive(Clone, Debug)]
pub struct HybridTape {
    /// `v` of each block.
    commands: Vec<Lane>,
    /// `c` before each block, and after the last.
    state: Vec<Lane>,
    /// `[c', calibration]` of each block.
    curved: Vec<Lane>,
    /// `[c', z]` of each block.
    after: Vec<Lane>,
    calibration: [Lane; CALIBRATION],
    drive: Vec<Lane>,
    /// Openings of each block.
    source: Vec<[Lane; SOURCE]>,
    flow: Vec<Flow>,
    lungs: Lungs,
    start: [Lane; START_INPUTS],
    /// Plateau less pressure at the start, cmH2O.
    fall: Lane,
    /// Group of each lane, below zero where it is unknown.
    group: Lane,
    pressure: Lane,
    alveolar: Lane,
    d_hidden: Vec<Lane>,
    d_drive: Vec<Lane>,
    d_source: Vec<Lane>,
    d_decay: Vec<Lane>,
    /// Gradients by states and calibration.
    d_state: Vec<Lane>,
    d_pressure: Lane,
    d_alveolar: Lane,
    d_lungs: LungGradients,
    scratch: Vec<Lane>,
}

impl Hybrid {
    /// A model from its parameters.
    ///
    /// # Panics
    /// If `parameters` does not have [`HybridConfig::parameters`] entries.
    pub fn new(config: HybridConfig, parameters: &[f32]) -> Self {
        let ([filters, curves, source, start], decay_offset, total) = config.layout();
        assert_eq!(parameters.len(), total, "parameters of another shape");
        let (decays, physics) = parameters[decay_offset..].split_at(config.states);
        let (physics, deviations) = physics.split_at(PHYSICS);
        Self {
            config,
            filters: filters.load(parameters),
            curves: curves.load(parameters),
            source: source.load(parameters),
            start: start.load(parameters),
            physics: Physics::new(physics),
            deviations: deviations.as_chunks().0.to_vec(),
            decay_offset,
            keep: decays.iter().map(|d| sigmoid(*d)).collect(),
        }
    }

    fn newest(&self, block: usize) -> Option<usize> {
        block.checked_sub(self.config.timing.lag())
    }

    /// Duration of one step of the lung, s.
    fn step_s(&self) -> f32 {
        let timing = &self.config.timing;
        timing.block_ticks as f32 * timing.period_us as f32 * 1e-6 / timing.points as f32
    }

    /// Deviations of the group in a lane.
    fn deviation(&self, start: &Start, l: usize) -> [f32; DEVIATIONS] {
        group(start, l).and_then(|group| self.deviations.get(group)).copied().unwrap_or_default()
    }

    fn lungs(&self, start: &Start) -> Lungs {
        let physics = &self.physics;
        let step = ML_PER_L * self.step_s();
        let own = |n: usize| Lane::from_fn(|l| self.deviation(start, l)[n].exp());
        let resistance = start.resistance.zip(&own(0), |r, own| r / NOMINAL * own);
        let compliance = start.compliance.zip(&own(1), |c, own| c * own);
        Lungs {
            linear: resistance.map(|r| r * physics.linear.exp()),
            square: resistance.map(|r| r * physics.square.exp()),
            rise: compliance.map(|c| step / (c * physics.compliance.exp())),
            keep: physics.circuit.exp() / step,
            supply: physics.supply.exp(),
            openings: [own(2), own(3)],
        }
    }

    /// One implicit step of airway and lung under a source.
    fn flow(lungs: &Lungs, [inlet, outlet]: &[Lane; SOURCE], pressure: Lane, alveolar: Lane) -> (Flow, Lane) {
        let mut flow = Flow { pressure, alveolar, ..Flow::default() };
        let mut after = Lane::ZERO;
        for l in 0..crate::engine::LANES {
            let (p, a, k) = (pressure[l], alveolar[l], lungs.keep);
            let g = 2.0 / (lungs.linear[l] + root(lungs, l, p - a).0);
            let (g_in, g_out) = (inlet[l] * orifice(lungs.supply - p).0, outlet[l] * orifice(p).0);
            let next = (k * p + g_in * lungs.supply + g * a) / (k + g_in + g_out + g);
            flow.conductance[l] = g;
            flow.next[l] = next;
            after[l] = a + lungs.rise[l] * g * (next - a);
        }
        (flow, after)
    }

    /// The way back through [`Self::flow`]: takes the gradient by the next pressures from the tape, adds those by
    /// source and lung, and leaves those by the pressures before.
    fn flow_back(tape: &mut HybridTape, step: usize, source: &[Lane; SOURCE], d_source: &mut [Lane; SOURCE]) {
        let (flow, lungs) = (&tape.flow[step], &tape.lungs);
        for l in 0..crate::engine::LANES {
            let (p, a, next, g) = (flow.pressure[l], flow.alveolar[l], flow.next[l], flow.conductance[l]);
            let (inlet, outlet, k, supply) = (source[0][l], source[1][l], lungs.keep, lungs.supply);
            let ((share_in, slope_in), (share_out, slope_out)) = (orifice(supply - p), orifice(p));
            let (g_in, g_out) = (inlet * share_in, outlet * share_out);
            let (mut d_next, mut d_a) = (tape.d_pressure[l], tape.d_alveolar[l]);
            // a' = a + rise g (next - a)
            let d_flow = lungs.rise[l] * d_a;
            tape.d_lungs.rise[l] += d_flow * g * (next - a);
            let mut d_g = d_flow * (next - a);
            d_next += d_flow * g;
            d_a -= d_flow * g;
            // next = (k p + g_in supply + g a) / (k + g_in + g_out + g)
            let d = d_next / (k + g_in + g_out + g);
            let (d_in, d_out) = (d * (supply - next), -d * next);
            tape.d_lungs.keep[l] += d * (p - next) * k;
            tape.d_lungs.supply[l] += (d * g_in + d_in * inlet * slope_in) * supply;
            d_source[0][l] += d_in * share_in;
            d_source[1][l] += d_out * share_out;
            d_g += d * (a - next);
            let mut d_p = d * k - d_in * inlet * slope_in + d_out * outlet * slope_out;
            d_a += d * g;
            // g = 2 / (R1 + root)
            let (root, size) = root(lungs, l, p - a);
            let d_sum = -0.5 * g * g * d_g;
            tape.d_lungs.linear[l] += d_sum * (1.0 + lungs.linear[l] / root) * lungs.linear[l];
            tape.d_lungs.square[l] += d_sum * 2.0 * size / root * lungs.square[l];
            let d_drop = d_sum * 2.0 * lungs.square[l] / root * (p - a) / size;
            d_p += d_drop;
            d_a -= d_drop;
            tape.d_pressure[l] = d_p;
            tape.d_alveolar[l] = d_a;
        }
    }
}

/// `sqrt(R1^2 + 4 R2 |drop|)`, and `|drop|`, rounded off around zero.
fn root(lungs: &Lungs, l: usize, drop: f32) -> (f32, f32) {
    let size = (drop * drop + ROUNDING * ROUNDING).sqrt();
    ((lungs.linear[l] * lungs.linear[l] + 4.0 * lungs.square[l] * size).sqrt(), size)
}

/// Conductance of an opening of one under a pressure drop, and its slope: flow goes with the root of the drop, which is
/// rounded off around zero.
fn orifice(drop: f32) -> (f32, f32) {
    let square = drop * drop + 1.0;
    let share = 1.0 / square.sqrt().sqrt();
    (share, -0.5 * drop * share / square)
}

/// Index of the group in a lane; none where it is unknown.
fn group(start: &Start, l: usize) -> Option<usize> {
    (start.group[l] >= 0.0).then_some(start.group[l] as usize)
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// The `n`-th piece of `width` lanes.
fn piece(lanes: &[Lane], n: usize, width: usize) -> &[Lane] {
    &lanes[n * width..(n + 1) * width]
}

fn piece_mut(lanes: &mut [Lane], n: usize, width: usize) -> &mut [Lane] {
    &mut lanes[n * width..(n + 1) * width]
}

impl Dynamics for Hybrid {
    type Tape = HybridTape;

    fn timing(&self) -> &Timing {
        &self.config.timing
    }

    fn parameters(&self) -> usize {
        self.config.parameters()
    }

    fn tape(&self, blocks: usize) -> HybridTape {
        let HybridConfig { states, hidden, timing, .. } = self.config;
        let commands = self.config.commands();
        let zeros = |width: usize| vec![Lane::ZERO; blocks * width];
        HybridTape {
            commands: zeros(commands),
            state: vec![Lane::ZERO; (blocks + 1) * states],
            curved: zeros(states + CALIBRATION),
            after: zeros(states + hidden),
            calibration: [Lane::ZERO; CALIBRATION],
            drive: zeros(states),
            source: vec![[Lane::ZERO; SOURCE]; blocks],
            flow: vec![Flow::default(); blocks * timing.points],
            lungs: Lungs::default(),
            start: [Lane::ZERO; START_INPUTS],
            fall: Lane::ZERO,
            group: Lane::ZERO,
            pressure: Lane::ZERO,
            alveolar: Lane::ZERO,
            d_hidden: zeros(hidden),
            d_drive: zeros(states),
            d_source: zeros(SOURCE),
            d_decay: vec![Lane::ZERO; states],
            d_state: vec![Lane::ZERO; states + CALIBRATION],
            d_pressure: Lane::ZERO,
            d_alveolar: Lane::ZERO,
            d_lungs: LungGradients::default(),
            scratch: vec![Lane::ZERO; states + hidden + commands + states + CALIBRATION],
        }
    }

    fn begin(&self, tape: &mut HybridTape, start: &Start) {
        let (mean, scale) = PRESSURE_SCALE;
        let states = self.config.states;
        tape.start = [
            start.pressure.map(|p| (p - 5.0) / scale),
            start.rest,
            start.plateau.map(|p| (p - mean) / scale),
            start.plateau_command,
        ];
        let mut known = vec![Lane::ZERO; states + CALIBRATION];
        self.start.forward(&tape.start, &mut known);
        tape.state[..states].copy_from_slice(&known[..states]);
        tape.calibration.copy_from_slice(&known[states..]);
        tape.lungs = self.lungs(start);
        tape.group = start.group;
        tape.fall = start.plateau.zip(&start.pressure, |plateau, p| plateau - p);
        tape.pressure = start.pressure;
        tape.alveolar = start.pressure;
        tape.alveolar.add_scaled(self.physics.left, &tape.fall);
        tape.d_state.fill(Lane::ZERO);
        tape.d_decay.fill(Lane::ZERO);
        (tape.d_pressure, tape.d_alveolar) = (Lane::ZERO, Lane::ZERO);
        tape.d_lungs = LungGradients::default();
    }

    fn step(&self, tape: &mut HybridTape, block: usize, log: &CommandLog, points: &mut [Lane]) {
        let HybridConfig { states, hidden, history, .. } = self.config;
        let commands = piece_mut(&mut tape.commands, block, self.config.commands());
        log.gather(self.newest(block), history, commands);
        let drive = piece_mut(&mut tape.drive, block, states);
        self.filters.forward(commands, drive);
        let (before, after) = tape.state.split_at_mut((block + 1) * states);
        let before = piece(before, block, states);
        for (s, keep) in self.keep.iter().enumerate() {
            after[s] = before[s].zip(&drive[s], |c, g| keep * c + (1.0 - keep) * g);
        }
        let readout = piece_mut(&mut tape.after, block, states + hidden);
        let (c, z) = readout.split_at_mut(states);
        c.copy_from_slice(&after[..states]);
        let curved = piece_mut(&mut tape.curved, block, states + CALIBRATION);
        curved[..states].copy_from_slice(c);
        curved[states..].copy_from_slice(&tape.calibration);
        self.curves.forward(curved, z);
        Activation::Softsign.forward(z);
        let source = &mut tape.source[block];
        self.source.forward(readout, source);
        for (opening, own) in source.iter_mut().zip(&tape.lungs.openings) {
            *opening = opening.zip(own, |y, own| own * MOST_OPENING * sigmoid(y + USUAL_OPENING));
        }
        let count = points.len();
        for (n, point) in points.iter_mut().enumerate() {
            let (flow, after) = Self::flow(&tape.lungs, source, tape.pressure, tape.alveolar);
            (tape.pressure, tape.alveolar) = (flow.next, after);
            *point = flow.next;
            tape.flow[block * count + n] = flow;
        }
    }

    fn step_back(&self, tape: &mut HybridTape, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let HybridConfig { states, hidden, .. } = self.config;
        let source = tape.source[block];
        let mut d_source = [Lane::ZERO; SOURCE];
        for (n, d_point) in d_points.iter().enumerate().rev() {
            tape.d_pressure.add_scaled(1.0, d_point);
            Self::flow_back(tape, block * d_points.len() + n, &source, &mut d_source);
        }
        let d_y = piece_mut(&mut tape.d_source, block, SOURCE);
        for n in 0..SOURCE {
            let (own, d_own) = (tape.lungs.openings[n], &mut tape.d_lungs.openings[n]);
            let by_logarithm = d_source[n].zip(&source[n], |d, opening| d * opening);
            d_own.add_scaled(1.0, &by_logarithm);
            let left = source[n].zip(&own, |opening, own| 1.0 - opening / (own * MOST_OPENING));
            d_y[n] = by_logarithm.zip(&left, |d, left| d * left);
        }

        let (d_after, rest) = tape.scratch.split_at_mut(states + hidden);
        let (d_curved, d_commands) = rest.split_at_mut(states + CALIBRATION);
        d_after.fill(Lane::ZERO);
        self.source.backward(d_y, d_after);
        let (d_c, from_source) = d_after.split_at_mut(states);
        let d_z = piece_mut(&mut tape.d_hidden, block, hidden);
        d_z.copy_from_slice(from_source);
        let z = &piece(&tape.after, block, states + hidden)[states..];
        Activation::Softsign.backward(z, d_z);
        d_curved.fill(Lane::ZERO);
        self.curves.backward(d_z, d_curved);
        for (d_c, d) in d_c.iter_mut().zip(&*d_curved) {
            d_c.add_scaled(1.0, d);
        }
        for (d_calibration, d) in tape.d_state[states..].iter_mut().zip(&d_curved[states..]) {
            d_calibration.add_scaled(1.0, d);
        }

        // States: c' = a c + (1 - a) g.
        let before = piece(&tape.state, block, states);
        let drive = piece(&tape.drive, block, states);
        let d_drive = piece_mut(&mut tape.d_drive, block, states);
        for (s, keep) in self.keep.iter().enumerate() {
            let mut d = tape.d_state[s];
            d.add_scaled(1.0, &d_c[s]);
            let difference = before[s].zip(&drive[s], |c, g| keep * (1.0 - keep) * (c - g));
            tape.d_decay[s].add_scaled(1.0, &d.zip(&difference, |d, x| d * x));
            d_drive[s] = d.map(|d| (1.0 - keep) * d);
            tape.d_state[s] = d.map(|d| keep * d);
        }
        d_commands.fill(Lane::ZERO);
        self.filters.backward(d_drive, d_commands);
        d_log.scatter(self.newest(block), d_commands);
    }

    fn finish(&self, tape: &mut HybridTape, gradient: &mut [f32]) {
        let states = self.config.states;
        self.filters.shape().gradient(&tape.d_drive, &tape.commands, gradient);
        self.curves.shape().gradient(&tape.d_hidden, &tape.curved, gradient);
        self.source.shape().gradient(&tape.d_source, &tape.after, gradient);
        self.start.shape().gradient(&tape.d_state, &tape.start, gradient);
        let (decays, physics) = gradient[self.decay_offset..].split_at_mut(states);
        for (gradient, d) in decays.iter_mut().zip(&tape.d_decay) {
            *gradient += d.sum();
        }
        let d = &tape.d_lungs;
        let product = |a: &Lane, b: &Lane| a.zip(b, |a, b| a * b).sum();
        let by_physics = [
            d.linear.sum(),
            d.square.sum(),
            // What a step adds falls as the compliance grows.
            -d.rise.sum(),
            d.keep.sum(),
            product(&tape.d_alveolar, &tape.fall),
            d.supply.sum(),
        ];
        let (physics, deviations) = physics.split_at_mut(PHYSICS);
        for (gradient, d) in physics.iter_mut().zip(by_physics) {
            *gradient += d;
        }
        for l in 0..crate::engine::LANES {
            let own = (tape.group[l] >= 0.0).then_some(tape.group[l] as usize * DEVIATIONS);
            let Some(own) = own.and_then(|first| deviations.get_mut(first..first + DEVIATIONS)) else {
                continue;
            };
            own[0] += d.linear[l] + d.square[l];
            own[1] -= d.rise[l];
            own[2] += d.openings[0][l];
            own[3] += d.openings[1][l];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::LANES;
    use crate::simulator::tests_support::check_gradients;
    use rand_chacha::rand_core::SeedableRng;

    fn config(period_us: u32) -> HybridConfig {
        HybridConfig { states: 5, hidden: 7, history: 3, groups: 2, ..HybridConfig::for_period(period_us, 1) }
    }

    #[test]
    fn gradients_of_a_rollout_agree_with_finite_differences() {
        for period_us in [1000, 30_000] {
            let config = config(period_us);
            let mut parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(3));
            check_gradients(&parameters, |p| Hybrid::new(config, p));
            // Once more with the physics away from where they start, all of them.
            let physics = parameters.len() - PHYSICS - config.groups * DEVIATIONS;
            parameters[physics..physics + PHYSICS].copy_from_slice(&[1.8, 2.8, 0.2, 0.9, 0.3, 3.7]);
            check_gradients(&parameters, |p| Hybrid::new(config, p));
        }
    }

    #[test]
    fn the_physics_have_the_gradients_of_finite_differences() {
        let config = HybridConfig {
            states: 1,
            hidden: 1,
            history: 1,
            groups: 3,
            ..HybridConfig::for_period(30_000, 1)
        };
        let mut parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(5));
        let physics = parameters.len() - PHYSICS - 3 * DEVIATIONS;
        for (n, deviation) in parameters[physics + PHYSICS..].iter_mut().enumerate() {
            *deviation = 0.1 * (n as f32).sin();
        }
        parameters[physics..physics + PHYSICS].copy_from_slice(&[1.8, 2.8, 0.2, 0.9, 0.3, 3.7]);
        // So few parameters that every one is compared.
        assert!(parameters.len() < 150);
        check_gradients(&parameters, |p| Hybrid::new(config, p));
    }

    /// Pressure and volume (mL) in each lane after a long blow with a constant command.
    fn blown(resistance: Lane, compliance: Lane, blocks: usize) -> (Lane, Lane) {
        let config = config(10_000);
        let model = Hybrid::new(config, &config.initialise(&mut ChaCha8Rng::seed_from_u64(4)));
        let (mut tape, mut points) = (model.tape(blocks), vec![Lane::ZERO; 1]);
        let log = CommandLog::new(blocks, vec![Lane::splat(1.0); 1]);
        let pressure = Lane::splat(5.0);
        model.begin(
            &mut tape,
            &Start { pressure, plateau: pressure, resistance, compliance, ..Start::default() },
        );
        for block in 0..blocks {
            model.step(&mut tape, block, &log, &mut points);
        }
        (points[0], tape.alveolar.zip(&compliance, |a, c| (a - 5.0) * c))
    }

    #[test]
    fn a_stiff_or_narrow_lung_is_at_a_higher_pressure_with_less_in_it() {
        let sizes = Lane::from_fn(|l| 5.0 + 3.0 * l as f32);
        let (pressure, volume) = blown(Lane::splat(20.0), sizes, 20);
        for l in 1..LANES {
            assert!(pressure[l] < pressure[l - 1] && volume[l] > volume[l - 1], "compliance, lane {l}");
        }
        let (pressure, volume) = blown(sizes, Lane::splat(20.0), 20);
        for l in 1..LANES {
            assert!(pressure[l] > pressure[l - 1] && volume[l] < volume[l - 1], "resistance, lane {l}");
        }
    }
}
