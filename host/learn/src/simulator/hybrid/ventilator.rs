//! The ventilator of the hybrid: commands in, two openings out, one towards a supply and one towards the room.
//!
//! ```text
//! c'   = a c + (1 - a) (W1 v + b1)       valve: filters of past commands v, a = sigmoid(decay)
//! z    = softsign(W2 c' + b2 + s)        their static curves, shifted by s for each ventilator
//! A, B = m exp(o) sigmoid(W3 [c', z] + b3)   openings, up to a bound m that each ventilator stretches by o
//! ```
//!
//! It has no memory beyond its filters, and never learns of the pressure: one that does can tell a test run by its commands, and
//! learns runs in place of a ventilator.

use rand_chacha::ChaCha8Rng;

use super::own::Own;
use crate::simulator::leaky::{Leaky, sigmoid};
use crate::simulator::{BreathStart, CommandLog, Members, Timing, piece, piece_mut};
use engine::activation::Activation;
use engine::dense::{DenseLayer, DenseWeights};
use engine::{LANES, Lane};

/// Openings: towards the supply and towards the room.
pub(super) const OPENINGS: usize = 2;
/// Openings of a shard, L/s per root of cmH2O.
pub(super) type Openings = [Lane; OPENINGS];
/// Bound of an opening, L/s per root of cmH2O.
const MOST_OPENING: f32 = 0.6;
/// Opening where the network says nothing, as the sigmoid's argument: a fifth of the bound.
const USUAL_OPENING: f32 = -1.4;
/// Slowest filter to start with, s.
const LONGEST_FILTER_S: f32 = 0.2;

/// Shape of the ventilator.
#[derive(Clone, Copy, Debug)]
pub(super) struct VentilatorShape {
    pub timing: Timing,
    /// Filters of past commands.
    pub states: usize,
    /// Static curves.
    pub hidden: usize,
    /// Blocks of past commands that a step sees.
    pub history: usize,
    /// Ventilators of the recording.
    pub ventilators: usize,
}

impl VentilatorShape {
    fn commands(&self) -> usize {
        self.history * self.timing.width()
    }

    /// What each ventilator has of its own: shifts of the curves, stretches of the openings.
    fn own(&self) -> usize {
        self.hidden + OPENINGS
    }

    /// Layers (filters, curves, source, start), index of the decays, number of parameters; what ventilators own is last.
    fn layout(&self) -> ([DenseLayer; 4], usize, usize) {
        let (layers, decay) = DenseLayer::layout([
            (self.commands(), self.states),
            (self.states, self.hidden),
            (self.states + self.hidden, OPENINGS),
            (BreathStart::KNOWN, self.states),
        ]);
        (layers, decay, decay + self.states + self.ventilators * self.own())
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.layout().2
    }

    /// Draws parameters: time constants from one block to `LONGEST_FILTER_S`, all ventilators alike.
    pub fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let ([filters, curves, source, start], decay, total) = self.layout();
        let mut parameters = vec![0.0; total];
        filters.initialise(&mut parameters, 1.0, rng);
        curves.initialise(&mut parameters, 1.0, rng);
        source.initialise(&mut parameters, 0.5, rng);
        start.initialise(&mut parameters, 0.3, rng);
        for (n, decay) in parameters[decay..decay + self.states].iter_mut().enumerate() {
            let share = n as f32 / (self.states - 1).max(1) as f32;
            *decay = share * (LONGEST_FILTER_S / self.timing.block_s()).max(1.0).ln();
        }
        parameters
    }
}

/// The ventilator with its parameters.
#[derive(Clone, Debug)]
pub(super) struct VentilatorModel {
    shape: VentilatorShape,
    filters: DenseWeights,
    curves: DenseWeights,
    source: DenseWeights,
    start: DenseWeights,
    decay_offset: usize,
    leaky: Leaky,
    own: Own,
}

/// Forward values and backward gradients of a rollout, block after block.
#[derive(Clone, Debug)]
pub(super) struct VentilatorTape {
    /// `v` of each block.
    commands: Vec<Lane>,
    /// `c` before each block, and after the last.
    state: Vec<Lane>,
    /// `[c', z]` of each block.
    after: Vec<Lane>,
    drive: Vec<Lane>,
    pub openings: Vec<Openings>,
    known: [Lane; BreathStart::KNOWN],
    /// Which ventilator it is in each lane.
    members: Members,
    /// Its shifts.
    shifts: Vec<Lane>,
    /// What the openings are multiplied by.
    stretch: Openings,
    d_hidden: Vec<Lane>,
    d_drive: Vec<Lane>,
    d_source: Vec<Lane>,
    d_decay: Vec<Lane>,
    d_state: Vec<Lane>,
    /// Gradient by the logarithms of the stretch.
    pub d_stretch: Openings,
    scratch: Vec<Lane>,
}

impl VentilatorModel {
    /// The ventilator from its parameters.
    pub fn new(shape: VentilatorShape, parameters: &[f32]) -> Self {
        let ([filters, curves, source, start], decay_offset, total) = shape.layout();
        assert_eq!(parameters.len(), total, "parameters of another shape");
        let (decays, own) = parameters[decay_offset..].split_at(shape.states);
        Self {
            shape,
            filters: filters.load(parameters),
            curves: curves.load(parameters),
            source: source.load(parameters),
            start: start.load(parameters),
            decay_offset,
            leaky: Leaky::new(decays),
            own: Own::new(shape.own(), own),
        }
    }

    fn newest(&self, block: usize) -> Option<usize> {
        block.checked_sub(self.shape.timing.lag())
    }

    /// Memory for a rollout of so many blocks.
    pub fn tape(&self, blocks: usize) -> VentilatorTape {
        let VentilatorShape { states, hidden, .. } = self.shape;
        let commands = self.shape.commands();
        let zeros = |width: usize| vec![Lane::ZERO; blocks * width];
        VentilatorTape {
            commands: zeros(commands),
            state: vec![Lane::ZERO; (blocks + 1) * states],
            after: zeros(states + hidden),
            drive: zeros(states),
            openings: vec![[Lane::ZERO; OPENINGS]; blocks],
            known: [Lane::ZERO; BreathStart::KNOWN],
            members: [None; LANES],
            shifts: vec![Lane::ZERO; hidden],
            stretch: [Lane::ZERO; OPENINGS],
            d_hidden: zeros(hidden),
            d_drive: zeros(states),
            d_source: zeros(OPENINGS),
            d_decay: vec![Lane::ZERO; states],
            d_state: vec![Lane::ZERO; states],
            d_stretch: [Lane::ZERO; OPENINGS],
            scratch: vec![Lane::ZERO; states + hidden + commands],
        }
    }

    /// Starts a breath; `stretch` holds logarithms of what the test run multiplies its openings by.
    pub fn begin(&self, tape: &mut VentilatorTape, start: &BreathStart, stretch: &Openings) {
        tape.known = start.known();
        tape.members = start.ventilator;
        self.start.forward(&tape.known, &mut tape.state[..self.shape.states]);
        for (n, shift) in tape.shifts.iter_mut().enumerate() {
            *shift = self.own.lane(&tape.members, n);
        }
        for (n, run) in stretch.iter().enumerate() {
            let own = self.own.lane(&tape.members, self.shape.hidden + n);
            tape.stretch[n] = own.zip(run, |own, run| (own + run).exp());
        }
        tape.d_state.fill(Lane::ZERO);
        tape.d_decay.fill(Lane::ZERO);
        tape.d_stretch.fill(Lane::ZERO);
    }

    /// The openings of a block.
    pub fn step(&self, tape: &mut VentilatorTape, block: usize, log: &CommandLog) {
        let VentilatorShape { states, hidden, history, .. } = self.shape;
        let commands = piece_mut(&mut tape.commands, block, self.shape.commands());
        log.gather(self.newest(block), history, commands);
        let drive = piece_mut(&mut tape.drive, block, states);
        self.filters.forward(commands, drive);
        let (before, after) = tape.state.split_at_mut((block + 1) * states);
        let before = piece(before, block, states);
        self.leaky.step(before, drive, after);
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

    /// One block back, from the gradient by its openings.
    pub fn step_back(
        &self,
        tape: &mut VentilatorTape,
        block: usize,
        d_openings: &Openings,
        d_log: &mut CommandLog,
    ) {
        let VentilatorShape { states, hidden, .. } = self.shape;
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

        for (d_state, d) in tape.d_state.iter_mut().zip(&*d_c) {
            d_state.add_scaled(1.0, d);
        }
        let before = piece(&tape.state, block, states);
        let drive = piece(&tape.drive, block, states);
        let d_drive = piece_mut(&mut tape.d_drive, block, states);
        self.leaky.step_back(before, drive, &mut tape.d_state, d_drive, &mut tape.d_decay);
        self.filters.backward(d_drive, d_commands);
        d_log.scatter(self.newest(block), d_commands);
    }

    /// Adds the gradient by the parameters, once all blocks have gone back.
    pub fn finish(&self, tape: &VentilatorTape, gradient: &mut [f32]) {
        let VentilatorShape { states, hidden, .. } = self.shape;
        self.filters.shape().gradient(&tape.d_drive, &tape.commands, gradient);
        let c: Vec<Lane> =
            tape.after.chunks_exact(states + hidden).flat_map(|after| &after[..states]).copied().collect();
        self.curves.shape().gradient(&tape.d_hidden, &c, gradient);
        self.source.shape().gradient(&tape.d_source, &tape.after, gradient);
        self.start.shape().gradient(&tape.d_state, &tape.known, gradient);
        let (decays, own) = gradient[self.decay_offset..].split_at_mut(states);
        for (gradient, d) in decays.iter_mut().zip(&tape.d_decay) {
            *gradient += d.sum();
        }
        let mut d_shifts = vec![Lane::ZERO; hidden];
        for d_z in tape.d_hidden.chunks_exact(hidden) {
            for (d_shift, d) in d_shifts.iter_mut().zip(d_z) {
                d_shift.add_scaled(1.0, d);
            }
        }
        for (n, d) in d_shifts.iter().chain(&tape.d_stretch).enumerate() {
            self.own.add_gradient(&tape.members, n, d, own);
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

    /// A breath of a ventilator that every third lane does not know; sum of its openings, each with a weight.
    fn breathe(shape: VentilatorShape, parameters: &[f32]) -> (VentilatorModel, VentilatorTape, f64) {
        let model = VentilatorModel::new(shape, parameters);
        let mut tape = model.tape(BLOCKS);
        let ventilator = std::array::from_fn(|l| (l as u32 % 3).checked_sub(1));
        let start = BreathStart {
            pressure: Lane::splat(6.0),
            ventilator,
            rest: Lane::splat(0.2),
            ..BreathStart::default()
        };
        model.begin(&mut tape, &start, &[Lane::splat(0.1), Lane::splat(-0.2)]);
        let mut log = CommandLog::new(BLOCKS, vec![Lane::splat(0.2); shape.timing.width()]);
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
        let timing = Timing::for_period(10_000, 1);
        let shape = VentilatorShape { timing, states: 3, hidden: 4, history: 2, ventilators: 2 };
        let mut parameters = shape.initialise(&mut ChaCha8Rng::seed_from_u64(7));
        let own = parameters.len() - shape.ventilators * shape.own();
        for (n, parameter) in parameters[own..].iter_mut().enumerate() {
            *parameter = 0.1 * (n as f32).sin();
        }
        let (model, mut tape, _) = breathe(shape, &parameters);
        let mut d_log = CommandLog::new(BLOCKS, vec![Lane::ZERO; timing.width()]);
        for block in (0..BLOCKS).rev() {
            model.step_back(&mut tape, block, &[weight(block, 0), weight(block, 1)], &mut d_log);
        }
        let mut gradient = vec![0.0; parameters.len()];
        model.finish(&tape, &mut gradient);
        check_slopes("parameter", &parameters, 5e-3, &gradient, |varied| breathe(shape, varied).2);
    }
}
