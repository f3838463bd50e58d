//! The ventilator of the hybrid: commands in, two openings out, one towards the supply and one towards the room.
//!
//! ```text
//! c'   = a c + (1 - a) (W1 v + b1)       valve: filters of past commands v, a = sigmoid(decay)
//! z    = softsign(W2 c' + b2 + s)        their static curves, shifted by s for each ventilator
//! A, B = m exp(o) sigmoid(W3 [c', z] + b3)   openings, up to a bound m scaled by o for each ventilator
//! ```
//!
//! It has no memory beyond its filters and no pressure input: with one, it could recognise a test run by its commands
//! and would learn runs in place of a ventilator.

use rand_chacha::ChaCha8Rng;

use super::HybridConfig;
use super::own::Own;
use crate::simulator::leaky::{LeakyStates, LeakyTape, sigmoid};
use crate::simulator::recurrent::GAINS;
use crate::simulator::{BreathStart, CommandLog, Members, piece, piece_mut};
use engine::activation::Activation;
use engine::dense::{DenseLayer, DenseWeights};
use engine::{LANES, Lane};

/// Number of openings: towards the supply and towards the room.
pub(super) const OPENINGS: usize = 2;
/// Openings of a shard, L/s per root of cmH2O.
pub(super) type Openings = [Lane; OPENINGS];
/// Bound of an opening, L/s per root of cmH2O.
pub(super) const MOST_OPENING: f32 = 0.6;
/// Opening for a zero network output, as the sigmoid's argument: a fifth of the bound.
pub(super) const USUAL_OPENING: f32 = -1.4;
/// Initial time constant of the slowest filter, s.
const LONGEST_FILTER_S: f32 = 0.2;

impl HybridConfig {
    fn commands(&self) -> usize {
        self.history * self.timing.width()
    }

    /// Number of parameters of each ventilator: shifts of the curves, scales of the openings.
    fn own(&self) -> usize {
        self.hidden + OPENINGS
    }

    /// Layers (filters, curves, source, start), index of the decays, and index of the ventilators' own parameters
    /// (last).
    pub(super) fn ventilator_layout(&self) -> ([DenseLayer; 4], usize, usize) {
        let (layers, decay) = DenseLayer::layout([
            (self.commands(), self.states),
            (self.states, self.hidden),
            (self.states + self.hidden, OPENINGS),
            (BreathStart::KNOWN, self.states),
        ]);
        (layers, decay, decay + self.states)
    }

    /// Number of parameters of the ventilator.
    pub(super) fn ventilator_parameters(&self) -> usize {
        self.ventilator_layout().2 + self.ventilators * self.own()
    }

    /// Draws initial parameters: time constants from one block to `LONGEST_FILTER_S`, the same for all ventilators.
    pub(super) fn initialise_ventilator(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let (layers, decay, own) = self.ventilator_layout();
        let mut parameters = vec![0.0; self.ventilator_parameters()];
        for (layer, gain) in layers.iter().zip(GAINS) {
            layer.initialise(&mut parameters, gain, rng);
        }
        for (n, decay) in parameters[decay..own].iter_mut().enumerate() {
            let share = n as f32 / (self.states - 1).max(1) as f32;
            *decay = share * (LONGEST_FILTER_S / self.timing.block_s()).max(1.0).ln();
        }
        parameters
    }
}

/// The ventilator with its parameters.
#[derive(Clone, Debug)]
pub(super) struct VentilatorModel {
    config: HybridConfig,
    filters: LeakyStates,
    curves: DenseWeights,
    source: DenseWeights,
    own_offset: usize,
    own: Own,
}

/// Forward values and backward gradients of a rollout, block by block.
#[derive(Clone, Debug)]
pub(super) struct VentilatorTape {
    /// `v` of each block.
    commands: Vec<Lane>,
    /// `c` before each block, and after the last.
    state: Vec<Lane>,
    /// `[c', z]` of each block.
    after: Vec<Lane>,
    filters: LeakyTape,
    pub openings: Vec<Openings>,
    /// The ventilator in each lane.
    members: Members,
    /// Shifts of its curves.
    shifts: Vec<Lane>,
    /// Factors on the openings.
    stretch: Openings,
    d_hidden: Vec<Lane>,
    d_source: Vec<Lane>,
    /// Gradient with respect to the logarithms of the factors.
    pub d_stretch: Openings,
    scratch: Vec<Lane>,
}

impl VentilatorModel {
    /// The ventilator from its parameters.
    pub fn new(config: HybridConfig, parameters: &[f32]) -> Self {
        let ([filters, curves, source, start], decay, own_offset) = config.ventilator_layout();
        Self {
            config,
            filters: LeakyStates::new(&start, &filters, decay, parameters),
            curves: curves.load(parameters),
            source: source.load(parameters),
            own_offset,
            own: Own::new(config.own(), &parameters[own_offset..]),
        }
    }

    fn newest(&self, block: usize) -> Option<usize> {
        block.checked_sub(self.config.timing.lag())
    }

    /// Memory for a rollout of `blocks` blocks.
    pub fn tape(&self, blocks: usize) -> VentilatorTape {
        let HybridConfig { states, hidden, .. } = self.config;
        let commands = self.config.commands();
        let zeros = |width: usize| vec![Lane::ZERO; blocks * width];
        VentilatorTape {
            commands: zeros(commands),
            state: vec![Lane::ZERO; (blocks + 1) * states],
            after: zeros(states + hidden),
            filters: self.filters.tape(blocks),
            openings: vec![[Lane::ZERO; OPENINGS]; blocks],
            members: [None; LANES],
            shifts: vec![Lane::ZERO; hidden],
            stretch: [Lane::ZERO; OPENINGS],
            d_hidden: zeros(hidden),
            d_source: zeros(OPENINGS),
            d_stretch: [Lane::ZERO; OPENINGS],
            scratch: vec![Lane::ZERO; states + hidden + commands],
        }
    }

    /// Starts a breath; `stretch` contains the logarithms of the test run's factors on its openings.
    pub fn begin(&self, tape: &mut VentilatorTape, start: &BreathStart, stretch: &Openings) {
        tape.members = start.ventilator;
        self.filters.begin(&mut tape.filters, &start.known(), &mut tape.state[..self.config.states]);
        for (n, shift) in tape.shifts.iter_mut().enumerate() {
            *shift = self.own.lane(&tape.members, n);
        }
        for (n, run) in stretch.iter().enumerate() {
            let own = self.own.lane(&tape.members, self.config.hidden + n);
            tape.stretch[n] = own.zip(run, |own, run| (own + run).exp());
        }
        tape.d_stretch.fill(Lane::ZERO);
    }

    /// The openings of a block.
    pub fn step(&self, tape: &mut VentilatorTape, block: usize, log: &CommandLog) {
        let HybridConfig { states, hidden, history, .. } = self.config;
        let commands = piece_mut(&mut tape.commands, block, self.config.commands());
        log.gather(self.newest(block), history, commands);
        let (before, after) = tape.state.split_at_mut((block + 1) * states);
        let before = piece(before, block, states);
        self.filters.step(&mut tape.filters, block, before, commands, after);
        let readout = piece_mut(&mut tape.after, block, states + hidden);
        let (c, z) = readout.split_at_mut(states);
        c.copy_from_slice(&after[..states]);
        self.curves.forward(c, z);
        for (z, shift) in z.iter_mut().zip(&tape.shifts) {
            z.add_scaled(1.0, shift);
        }
        Activation::Softsign.forward(z);
        let openings = &mut tape.openings[block];
        self.source.forward(readout, openings);
        for (opening, stretch) in openings.iter_mut().zip(&tape.stretch) {
            *opening = opening.zip(stretch, |y, s| s * MOST_OPENING * sigmoid(y + USUAL_OPENING));
        }
    }

    /// Backward pass of one block, from the gradient with respect to its openings.
    pub fn step_back(
        &self,
        tape: &mut VentilatorTape,
        block: usize,
        d_openings: &Openings,
        d_log: &mut CommandLog,
    ) {
        let HybridConfig { states, hidden, .. } = self.config;
        let d_y = piece_mut(&mut tape.d_source, block, OPENINGS);
        for n in 0..OPENINGS {
            let opening = &tape.openings[block][n];
            let by_logarithm = d_openings[n].zip(opening, |d, opening| d * opening);
            tape.d_stretch[n].add_scaled(1.0, &by_logarithm);
            let left = opening.zip(&tape.stretch[n], |opening, s| 1.0 - opening / (s * MOST_OPENING));
            d_y[n] = by_logarithm.zip(&left, |d, left| d * left);
        }
        let (d_after, d_commands) = tape.scratch.split_at_mut(states + hidden);
        self.source.backward(d_y, d_after);
        let (d_c, from_source) = d_after.split_at_mut(states);
        let d_z = piece_mut(&mut tape.d_hidden, block, hidden);
        d_z.copy_from_slice(from_source);
        Activation::Softsign.backward(&piece(&tape.after, block, states + hidden)[states..], d_z);
        self.curves.backward_add(d_z, d_c);

        let before = piece(&tape.state, block, states);
        self.filters.step_back(&mut tape.filters, block, before, d_c, d_commands);
        d_log.scatter(self.newest(block), d_commands);
    }

    /// Adds the gradient with respect to the parameters, after the backward pass of all blocks.
    pub fn finish(&self, tape: &VentilatorTape, gradient: &mut [f32]) {
        let HybridConfig { states, hidden, .. } = self.config;
        self.filters.finish(&tape.filters, &tape.commands, gradient);
        let c: Vec<Lane> =
            tape.after.chunks_exact(states + hidden).flat_map(|after| &after[..states]).copied().collect();
        self.curves.shape().gradient(&tape.d_hidden, &c, gradient);
        self.source.shape().gradient(&tape.d_source, &tape.after, gradient);
        let mut d_shifts = vec![Lane::ZERO; hidden];
        for d_z in tape.d_hidden.chunks_exact(hidden) {
            for (d_shift, d) in d_shifts.iter_mut().zip(d_z) {
                d_shift.add_scaled(1.0, d);
            }
        }
        for (n, d) in d_shifts.iter().chain(&tape.d_stretch).enumerate() {
            self.own.add_gradient(&tape.members, n, d, &mut gradient[self.own_offset..]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;
    use rand_chacha::rand_core::SeedableRng;

    const BLOCKS: usize = 6;

    fn weight(block: usize, opening: usize) -> Lane {
        Lane::from_fn(|l| 10.0 * ((7 * block + 3 * opening + l) as f32).cos())
    }

    /// A breath in which the ventilator of every third lane is unknown; returns the weighted sum of its openings.
    fn breathe(config: HybridConfig, parameters: &[f32]) -> (VentilatorModel, VentilatorTape, f64) {
        let model = VentilatorModel::new(config, parameters);
        let mut tape = model.tape(BLOCKS);
        let ventilator = std::array::from_fn(|l| (l as u32 % 3).checked_sub(1));
        let start = BreathStart {
            pressure: Lane::splat(6.0),
            ventilator,
            rest: Lane::splat(0.2),
            ..BreathStart::default()
        };
        model.begin(&mut tape, &start, &[Lane::splat(0.1), Lane::splat(-0.2)]);
        let mut log = CommandLog::new(BLOCKS, vec![Lane::splat(0.2); config.timing.width()]);
        let mut total = 0.0;
        for block in 0..BLOCKS {
            log.block_mut(block).fill(Lane::from_fn(|l| 0.6 + 0.4 * ((3 * block + l) as f32).sin()));
            model.step(&mut tape, block, &log);
            for (n, opening) in tape.openings[block].iter().enumerate() {
                total += (0..LANES).map(|l| f64::from(weight(block, n)[l] * opening[l])).sum::<f64>();
            }
        }
        (model, tape, total)
    }

    #[test]
    fn gradients_by_parameters_agree_with_finite_differences() {
        let config = HybridConfig {
            states: 3,
            hidden: 4,
            history: 2,
            ventilators: 2,
            ..HybridConfig::for_period(10_000, 1)
        };
        let mut parameters = config.initialise_ventilator(&mut ChaCha8Rng::seed_from_u64(7));
        let own = parameters.len() - config.ventilators * config.own();
        for (n, parameter) in parameters[own..].iter_mut().enumerate() {
            *parameter = 0.1 * (n as f32).sin();
        }
        let (model, mut tape, _) = breathe(config, &parameters);
        let mut d_log = CommandLog::new(BLOCKS, vec![Lane::ZERO; config.timing.width()]);
        for block in (0..BLOCKS).rev() {
            model.step_back(&mut tape, block, &[weight(block, 0), weight(block, 1)], &mut d_log);
        }
        let mut gradient = vec![0.0; parameters.len()];
        model.finish(&tape, &mut gradient);
        check_slopes("parameter", &parameters, 5e-3, &gradient, |varied| breathe(config, varied).2);
    }
}
