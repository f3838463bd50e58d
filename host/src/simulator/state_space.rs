//! Our simulator: a nonlinear state-space model.
//!
//! States are leaky integrators with learned time constants, driven by past commands and by a hidden layer that
//! sees states and commands:
//!
//! ```text
//! z  = softsign(W1 [c, v] + b1)          hidden layer
//! g  = W2 [z, v] + b2                    drive
//! c' = a c + (1 - a) g                   states, a = sigmoid(decay)
//! p  = 20 + 10 (W3 [c', z] + b3)         pressure at the block's points
//! ```
//!
//! `v` are the scaled commands of the last blocks. Slow linear states carry the lung's volume without loss,
//! fast ones the valve's lag; the hidden layer bends them. The start of a breath sets the states by an affine
//! map of what is known there.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{CommandLog, Dynamics, PRESSURE_SCALE, Start, Timing, USUAL_LUNG};
use crate::engine::Lane;
use crate::engine::activation::Activation;
use crate::engine::dense::{Dense, DenseWeights};

/// Quantities known at the start of a breath: pressure and last plateau; of a model of many lungs, the commands there too.
const START_INPUTS: usize = 2;
const START_INPUTS_OF_LUNGS: usize = 4;
/// What a model of many lungs is told of each: logarithms of R and C over 20.
const LUNG_INPUTS: usize = 2;

/// Shape of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StateSpaceConfig {
    /// How time is cut.
    pub timing: Timing,
    /// States.
    pub states: usize,
    /// Hidden units.
    pub hidden: usize,
    /// Blocks of past commands that a step sees.
    pub history: usize,
    /// Whether it is one model of many lungs, told the nominal R and C of each.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub lungs: bool,
}

impl StateSpaceConfig {
    /// The default shape for a control period in microseconds and so many command channels.
    pub fn for_period(period_us: u32, channels: usize) -> Self {
        Self {
            timing: Timing::for_period(period_us, channels),
            states: 16,
            hidden: 64,
            history: 4,
            lungs: false,
        }
    }

    fn commands(&self) -> usize {
        self.history * self.timing.width()
    }

    fn lung_inputs(&self) -> usize {
        if self.lungs { LUNG_INPUTS } else { 0 }
    }

    fn start_inputs(&self) -> usize {
        if self.lungs { START_INPUTS_OF_LUNGS } else { START_INPUTS }
    }

    /// Inputs of the hidden layer: states, commands, lung.
    fn inputs(&self) -> usize {
        self.states + self.commands() + self.lung_inputs()
    }

    /// Layers (hidden, drive, readout, start), index of the decays, number of parameters.
    fn layout(&self) -> ([Dense; 4], usize, usize) {
        let commands = self.commands();
        let (layers, decay) = Dense::layout([
            (self.inputs(), self.hidden),
            (self.hidden + commands, self.states),
            (self.states + self.hidden, self.timing.points),
            (self.start_inputs(), self.states),
        ]);
        (layers, decay, decay + self.states)
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.layout().2
    }

    /// Draws parameters: time constants from one block to three seconds, evenly spaced on a logarithmic scale.
    pub fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let ([hidden, drive, readout, start], decay, total) = self.layout();
        let mut parameters = vec![0.0; total];
        hidden.initialise(&mut parameters, 1.0, rng);
        drive.initialise(&mut parameters, 1.0, rng);
        readout.initialise(&mut parameters, 0.5, rng);
        start.initialise(&mut parameters, 0.3, rng);
        let block = self.timing.block_ticks as f32 * self.timing.period_us as f32 * 1e-6;
        for (n, decay) in parameters[decay..].iter_mut().enumerate() {
            let share = n as f32 / (self.states - 1).max(1) as f32;
            let tau = block * (3.0 / block).powf(share);
            *decay = (tau / block).ln(); // sigmoid(ln(tau / block)) = tau / (tau + block)
        }
        parameters
    }
}

/// The model with its parameters, ready to run.
#[derive(Clone, Debug)]
pub struct StateSpace {
    config: StateSpaceConfig,
    hidden: DenseWeights,
    drive: DenseWeights,
    readout: DenseWeights,
    start: DenseWeights,
    decay_offset: usize,
    /// `a` of each state.
    keep: Vec<f32>,
}

/// Forward values and backward gradients of a rollout, block after block.
#[derive(Clone, Debug)]
pub struct StateSpaceTape {
    /// `[c, v]` before each block, and the lung where there are many.
    state: Vec<Lane>,
    /// `[z, v]` of each block.
    hidden: Vec<Lane>,
    /// `[c', z]` of each block.
    after: Vec<Lane>,
    drive: Vec<Lane>,
    start: Vec<Lane>,
    lung: [Lane; LUNG_INPUTS],
    d_hidden: Vec<Lane>,
    d_drive: Vec<Lane>,
    d_readout: Vec<Lane>,
    d_decay: Vec<Lane>,
    /// Gradient by the states after the block that goes back next.
    d_state: Vec<Lane>,
    scratch: Vec<Lane>,
}

impl StateSpace {
    /// A model from its parameters.
    ///
    /// # Panics
    /// If `parameters` does not have [`StateSpaceConfig::parameters`] entries.
    pub fn new(config: StateSpaceConfig, parameters: &[f32]) -> Self {
        let ([hidden, drive, readout, start], decay_offset, total) = config.layout();
        assert_eq!(parameters.len(), total, "parameters of another shape");
        let keep = parameters[decay_offset..].iter().map(|d| 1.0 / (1.0 + (-d).exp())).collect();
        Self {
            config,
            hidden: hidden.load(parameters),
            drive: drive.load(parameters),
            readout: readout.load(parameters),
            start: start.load(parameters),
            decay_offset,
            keep,
        }
    }

    /// Index of the newest block whose commands step `block` may see.
    fn newest(&self, block: usize) -> Option<usize> {
        block.checked_sub(self.config.timing.lag())
    }
}

/// The `n`-th piece of `width` lanes.
fn piece(lanes: &[Lane], n: usize, width: usize) -> &[Lane] {
    &lanes[n * width..(n + 1) * width]
}

fn piece_mut(lanes: &mut [Lane], n: usize, width: usize) -> &mut [Lane] {
    &mut lanes[n * width..(n + 1) * width]
}

impl Dynamics for StateSpace {
    type Tape = StateSpaceTape;

    fn timing(&self) -> &Timing {
        &self.config.timing
    }

    fn parameters(&self) -> usize {
        self.config.parameters()
    }

    fn tape(&self, blocks: usize) -> StateSpaceTape {
        let StateSpaceConfig { states, hidden, timing, .. } = self.config;
        let commands = self.config.commands();
        let zeros = |width: usize| vec![Lane::ZERO; blocks * width];
        StateSpaceTape {
            state: vec![Lane::ZERO; (blocks + 1) * self.config.inputs()],
            hidden: zeros(hidden + commands),
            after: zeros(states + hidden),
            drive: zeros(states),
            start: vec![Lane::ZERO; self.config.start_inputs()],
            lung: [Lane::ZERO; LUNG_INPUTS],
            d_hidden: zeros(hidden),
            d_drive: zeros(states),
            d_readout: zeros(timing.points),
            d_decay: vec![Lane::ZERO; states],
            d_state: vec![Lane::ZERO; states],
            scratch: vec![Lane::ZERO; 2 * (hidden + self.config.inputs())],
        }
    }

    fn begin(&self, tape: &mut StateSpaceTape, start: &Start) {
        let (mean, scale) = PRESSURE_SCALE;
        let known = [
            start.pressure.map(|p| (p - 5.0) / scale),
            start.plateau.map(|p| (p - mean) / scale),
            start.rest,
            start.plateau_command,
        ];
        tape.start.copy_from_slice(&known[..self.config.start_inputs()]);
        let (resistance, compliance) = USUAL_LUNG;
        tape.lung = [
            start.resistance.map(|r| (r / resistance).ln()),
            start.compliance.map(|c| (c / compliance).ln()),
        ];
        self.start.forward(&tape.start, &mut tape.state[..self.config.states]);
        tape.d_state.fill(Lane::ZERO);
        tape.d_decay.fill(Lane::ZERO);
    }

    fn step(&self, tape: &mut StateSpaceTape, block: usize, log: &CommandLog, points: &mut [Lane]) {
        let StateSpaceConfig { states, hidden, history, .. } = self.config;
        let commands = self.config.commands();
        let inputs = self.config.inputs();
        let (before, after) = tape.state.split_at_mut((block + 1) * inputs);
        let before = piece_mut(before, block, inputs);
        log.gather(self.newest(block), history, &mut before[states..states + commands]);
        before[states + commands..].copy_from_slice(&tape.lung[..self.config.lung_inputs()]);

        let zv = piece_mut(&mut tape.hidden, block, hidden + commands);
        let (z, v) = zv.split_at_mut(hidden);
        self.hidden.forward(before, z);
        Activation::Softsign.forward(z);
        v.copy_from_slice(&before[states..states + commands]);

        let drive = piece_mut(&mut tape.drive, block, states);
        self.drive.forward(zv, drive);
        let readout = piece_mut(&mut tape.after, block, states + hidden);
        for (s, keep) in self.keep.iter().enumerate() {
            after[s] = before[s].zip(&drive[s], |c, g| keep * c + (1.0 - keep) * g);
            readout[s] = after[s];
        }
        readout[states..].copy_from_slice(&zv[..hidden]);
        self.readout.forward(readout, points);
        let (mean, scale) = PRESSURE_SCALE;
        for point in points {
            *point = point.map(|y| mean + scale * y);
        }
    }

    fn step_back(&self, tape: &mut StateSpaceTape, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let StateSpaceConfig { states, hidden, timing, .. } = self.config;
        let commands = self.config.commands();
        let d_y = piece_mut(&mut tape.d_readout, block, timing.points);
        for (d_y, d_point) in d_y.iter_mut().zip(d_points) {
            *d_y = d_point.map(|d| PRESSURE_SCALE.1 * d);
        }
        let inputs = self.config.inputs();
        let (first, second) = tape.scratch.split_at_mut(hidden + inputs);
        let d_after = &mut first[..states + hidden];
        d_after.fill(Lane::ZERO);
        self.readout.backward(d_y, d_after);

        // States: c' = a c + (1 - a) g.
        let before = piece(&tape.state, block, inputs);
        let drive = piece(&tape.drive, block, states);
        let d_drive = piece_mut(&mut tape.d_drive, block, states);
        for (s, keep) in self.keep.iter().enumerate() {
            let mut d = tape.d_state[s];
            d.add_scaled(1.0, &d_after[s]);
            let difference = before[s].zip(&drive[s], |c, g| keep * (1.0 - keep) * (c - g));
            tape.d_decay[s].add_scaled(1.0, &d.zip(&difference, |d, x| d * x));
            d_drive[s] = d.map(|d| (1.0 - keep) * d);
            tape.d_state[s] = d.map(|d| keep * d);
        }

        let d_zv = &mut second[..hidden + commands];
        d_zv.fill(Lane::ZERO);
        self.drive.backward(d_drive, d_zv);
        let d_z = piece_mut(&mut tape.d_hidden, block, hidden);
        for ((d_z, from_drive), from_readout) in d_z.iter_mut().zip(&*d_zv).zip(&d_after[states..]) {
            *d_z = from_drive.zip(from_readout, |a, b| a + b);
        }
        Activation::Softsign.backward(&piece(&tape.hidden, block, hidden + commands)[..hidden], d_z);

        let d_cv = &mut first[..inputs];
        d_cv[..states].copy_from_slice(&tape.d_state);
        d_cv[states..states + commands].copy_from_slice(&d_zv[hidden..]);
        d_cv[states + commands..].fill(Lane::ZERO);
        self.hidden.backward(d_z, d_cv);
        tape.d_state.copy_from_slice(&d_cv[..states]);
        d_log.scatter(self.newest(block), &d_cv[states..states + commands]);
    }

    fn finish(&self, tape: &mut StateSpaceTape, gradient: &mut [f32]) {
        let blocks = tape.drive.len() / self.config.states;
        let inputs = self.config.inputs();
        self.hidden.shape().gradient(&tape.d_hidden, &tape.state[..blocks * inputs], gradient);
        self.drive.shape().gradient(&tape.d_drive, &tape.hidden, gradient);
        self.readout.shape().gradient(&tape.d_readout, &tape.after, gradient);
        self.start.shape().gradient(&tape.d_state, &tape.start, gradient);
        for (gradient, d) in gradient[self.decay_offset..].iter_mut().zip(&tape.d_decay) {
            *gradient += d.sum();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::LANES;
    use crate::simulator::tests_support::check_gradients;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn gradients_of_a_rollout_agree_with_finite_differences() {
        for (period_us, lungs) in [(1000, false), (30_000, false), (10_000, true)] {
            let config = StateSpaceConfig {
                lungs,
                states: 5,
                hidden: 7,
                history: 3,
                ..StateSpaceConfig::for_period(period_us, 1)
            };
            let parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(3));
            check_gradients(&parameters, |p| StateSpace::new(config, p));
        }
    }

    #[test]
    fn commands_of_the_running_block_cannot_be_felt_in_it() {
        let config = StateSpaceConfig::for_period(1000, 1);
        let model = StateSpace::new(config, &config.initialise(&mut ChaCha8Rng::seed_from_u64(4)));
        let last_point = |command: f32, block: usize| {
            let (mut tape, mut points) = (model.tape(6), vec![Lane::ZERO; 2]);
            let mut log = CommandLog::new(6, vec![Lane::ZERO; 2]);
            log.block_mut(block).fill(Lane::splat(command));
            model.begin(&mut tape, &Start::default());
            for block in 0..6 {
                model.step(&mut tape, block, &log, &mut points);
            }
            points[1][LANES - 1]
        };
        assert_eq!(last_point(0.0, 5).to_bits(), last_point(1.0, 5).to_bits());
        assert!((last_point(0.0, 4) - last_point(1.0, 4)).abs() > 1e-4);
    }
}
