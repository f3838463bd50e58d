//! A network of leaky states driven by commands: the whole of [`state_space`](super::state_space), and in
//! [`hybrid`](super::hybrid) the part of a test run that a lung's physics does not explain.
//!
//! ```text
//! z  = softsign(W1 [c, v, k] + b1)       hidden layer
//! g  = W2 [z, v] + b2                    drive
//! c' = a c + (1 - a) g                   states, a = sigmoid(decay)
//! y  = W3 [c', z] + b3                   outputs
//! ```
//!
//! `v` are the scaled commands of the last blocks, `k` are constants of a breath. At the start of a breath the states
//! are set by an affine map of the known quantities.

use rand_chacha::ChaCha8Rng;

use super::block::Block;
use super::leaky::{self, LeakyStates, LeakyTape};
use super::{CommandLog, Timing, piece, piece_mut};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use engine::Lane;
use engine::activation::Activation;
use engine::dense::{DenseLayer, DenseWeights};

/// Scales of the layers' initial weights: the two stacked layers, the readout, and the start.
pub(super) const GAINS: [f32; 4] = [1.0, 1.0, 0.5, 0.3];

/// Shape of the network.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecurrentShape {
    /// Division of time into blocks.
    pub timing: Timing,
    /// Number of states.
    pub states: usize,
    /// Number of hidden units.
    pub hidden: usize,
    /// Number of past command blocks that a step sees.
    pub history: usize,
    /// Number of quantities known at the start of a breath.
    pub known: usize,
    /// Number of inputs that are constant during a breath.
    pub constants: usize,
    /// Number of outputs of each block.
    pub outputs: usize,
}

impl RecurrentShape {
    fn commands(&self) -> usize {
        self.history * self.timing.width()
    }

    /// Number of inputs of the hidden layer: states, commands, constants.
    fn inputs(&self) -> usize {
        self.states + self.commands() + self.constants
    }

    /// Layers (hidden, drive, readout, start), index of the decays, number of parameters.
    pub(super) fn layout(&self) -> ([DenseLayer; 4], usize, usize) {
        let commands = self.commands();
        let (layers, decay) = DenseLayer::layout([
            (self.inputs(), self.hidden),
            (self.hidden + commands, self.states),
            (self.states + self.hidden, self.outputs),
            (self.known, self.states),
        ]);
        (layers, decay, decay + self.states)
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.layout().2
    }

    /// Draws initial parameters: time constants from one block to `slowest_s`, evenly spaced on a logarithmic scale.
    pub fn initialise(&self, slowest_s: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let (layers, decay, total) = self.layout();
        let mut parameters = vec![0.0; total];
        for (layer, gain) in layers.iter().zip(GAINS) {
            layer.initialise(&mut parameters, gain, rng);
        }
        let block = self.timing.block_s();
        for (n, decay) in parameters[decay..].iter_mut().enumerate() {
            let share = n as f32 / (self.states - 1).max(1) as f32;
            let tau = block * (slowest_s / block).powf(share);
            *decay = (tau / block).ln(); // sigmoid(ln(tau / block)) = tau / (tau + block)
        }
        parameters
    }
}

/// The network with its parameters, ready to run.
#[derive(Clone, Debug)]
pub(super) struct RecurrentNetwork {
    shape: RecurrentShape,
    hidden: DenseWeights,
    states: LeakyStates,
    readout: DenseWeights,
}

/// Forward values and backward gradients of a rollout, block by block.
#[derive(Clone, Debug)]
pub(super) struct RecurrentTape {
    /// `[c, v, k]` before each block.
    state: Vec<Lane>,
    /// `[z, v]` of each block.
    hidden: Vec<Lane>,
    /// `[c', z]` of each block.
    after: Vec<Lane>,
    states: LeakyTape,
    constants: Vec<Lane>,
    d_hidden: Vec<Lane>,
    d_readout: Vec<Lane>,
    scratch: Vec<Lane>,
}

impl RecurrentNetwork {
    /// A network from its parameters.
    ///
    /// # Panics
    /// If `parameters` does not have [`RecurrentShape::parameters`] entries.
    pub fn new(shape: RecurrentShape, parameters: &[f32]) -> Self {
        let ([hidden, drive, readout, start], decay, total) = shape.layout();
        assert_eq!(parameters.len(), total, "parameters of another shape");
        Self {
            shape,
            hidden: hidden.load(parameters),
            states: LeakyStates::new(&start, &drive, decay, parameters),
            readout: readout.load(parameters),
        }
    }

    /// Index of the newest block whose commands step `block` may use.
    fn newest(&self, block: usize) -> Option<usize> {
        block.checked_sub(self.shape.timing.lag())
    }

    /// Memory for a rollout of `blocks` blocks.
    pub fn tape(&self, blocks: usize) -> RecurrentTape {
        let RecurrentShape { states, hidden, constants, outputs, .. } = self.shape;
        let (commands, inputs) = (self.shape.commands(), self.shape.inputs());
        let zeros = |width: usize| vec![Lane::ZERO; blocks * width];
        RecurrentTape {
            state: vec![Lane::ZERO; (blocks + 1) * inputs],
            hidden: zeros(hidden + commands),
            after: zeros(states + hidden),
            states: self.states.tape(blocks),
            constants: vec![Lane::ZERO; constants],
            d_hidden: zeros(hidden),
            d_readout: zeros(outputs),
            scratch: vec![Lane::ZERO; 2 * (hidden + inputs)],
        }
    }

    /// Starts a breath.
    pub fn begin(&self, tape: &mut RecurrentTape, known: &[Lane], constants: &[Lane]) {
        tape.constants.copy_from_slice(constants);
        self.states.begin(&mut tape.states, known, &mut tape.state[..self.shape.states]);
    }

    /// Runs one block forward.
    pub fn step(&self, tape: &mut RecurrentTape, block: usize, log: &CommandLog, outputs: &mut [Lane]) {
        let RecurrentShape { states, hidden, history, .. } = self.shape;
        let (commands, inputs) = (self.shape.commands(), self.shape.inputs());
        let (before, after) = tape.state.split_at_mut((block + 1) * inputs);
        let before = piece_mut(before, block, inputs);
        log.gather(self.newest(block), history, &mut before[states..states + commands]);
        before[states + commands..].copy_from_slice(&tape.constants);

        let zv = piece_mut(&mut tape.hidden, block, hidden + commands);
        let (z, v) = zv.split_at_mut(hidden);
        self.hidden.forward(before, z);
        Activation::Softsign.forward(z);
        v.copy_from_slice(&before[states..states + commands]);

        self.states.step(&mut tape.states, block, before, zv, after);
        let readout = piece_mut(&mut tape.after, block, states + hidden);
        readout[..states].copy_from_slice(&after[..states]);
        readout[states..].copy_from_slice(&zv[..hidden]);
        self.readout.forward(readout, outputs);
    }

    /// Backward pass of one block, from `d_outputs(n)`, the gradient with respect to its n-th output.
    pub fn step_back(
        &self,
        tape: &mut RecurrentTape,
        block: usize,
        d_outputs: impl Fn(usize) -> Lane,
        d_log: &mut CommandLog,
    ) {
        let RecurrentShape { states, hidden, outputs, .. } = self.shape;
        let (commands, inputs) = (self.shape.commands(), self.shape.inputs());
        let d_y = piece_mut(&mut tape.d_readout, block, outputs);
        for (n, d_y) in d_y.iter_mut().enumerate() {
            *d_y = d_outputs(n);
        }
        let (first, second) = tape.scratch.split_at_mut(hidden + inputs);
        let d_after = &mut first[..states + hidden];
        self.readout.backward(d_y, d_after);

        let before = piece(&tape.state, block, inputs);
        let d_zv = &mut second[..hidden + commands];
        self.states.step_back(&mut tape.states, block, before, d_after, d_zv);
        let d_z = piece_mut(&mut tape.d_hidden, block, hidden);
        for ((d_z, from_drive), from_readout) in d_z.iter_mut().zip(&*d_zv).zip(&d_after[states..]) {
            *d_z = from_drive.zip(from_readout, |a, b| a + b);
        }
        Activation::Softsign.backward(&piece(&tape.hidden, block, hidden + commands)[..hidden], d_z);

        let d_cv = &mut first[..inputs];
        d_cv[..states].copy_from_slice(&tape.states.d_state);
        d_cv[states..states + commands].copy_from_slice(&d_zv[hidden..]);
        d_cv[states + commands..].fill(Lane::ZERO);
        self.hidden.backward_add(d_z, d_cv);
        tape.states.d_state.copy_from_slice(&d_cv[..states]);
        d_log.scatter(self.newest(block), &d_cv[states..states + commands]);
    }

    /// Adds the gradient with respect to the parameters, after the backward pass of all blocks.
    pub fn finish(&self, tape: &RecurrentTape, gradient: &mut [f32]) {
        let used = tape.state.len() - self.shape.inputs();
        self.hidden.shape().gradient(&tape.d_hidden, &tape.state[..used], gradient);
        self.states.finish(&tape.states, &tape.hidden, gradient);
        self.readout.shape().gradient(&tape.d_readout, &tape.after, gradient);
    }
}

/// One step of the network as a graph; the state has a piece `states`.
pub(super) fn step_graph(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    (shape, parameters): (&RecurrentShape, &[f32]),
    known: &Value,
    (seen, constants): (&Value, Option<&Value>),
) -> Value {
    let ([hidden, drive, readout, start], decay, end) = shape.layout();
    leaky::begin_graph(graph, state, block, (&start, parameters), known);
    let before = state.get("states");
    let inputs: Vec<&Value> = [&before, seen].into_iter().chain(constants).collect();
    let inputs = graph.join(&inputs);
    let z = graph.layer(&inputs, &hidden, parameters);
    let z = graph.op("Softsign", &[&z]);
    let drives = graph.join(&[&z, seen]);
    let after = leaky::step_graph(graph, state, (&drive, parameters), &parameters[decay..end], &drives);
    let readouts = graph.join(&[&after, &z]);
    graph.layer(&readouts, &readout, parameters)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;
    use engine::LANES;
    use rand_chacha::rand_core::SeedableRng;

    const BLOCKS: usize = 6;

    fn weight(block: usize, output: usize) -> Lane {
        Lane::from_fn(|l| ((7 * block + 3 * output + l) as f32).cos())
    }

    /// Runs a breath; returns the weighted sum of all outputs, with different weights.
    fn breathe(shape: RecurrentShape, parameters: &[f32]) -> (RecurrentNetwork, RecurrentTape, f64) {
        let network = RecurrentNetwork::new(shape, parameters);
        let mut tape = network.tape(BLOCKS);
        network.begin(&mut tape, &[Lane::splat(0.3), Lane::splat(-0.4)], &[Lane::splat(0.5)]);
        let mut log = CommandLog::new(BLOCKS, vec![Lane::splat(0.2); shape.timing.width()]);
        let (mut outputs, mut total) = (vec![Lane::ZERO; shape.outputs], 0.0);
        for block in 0..BLOCKS {
            log.block_mut(block).fill(Lane::from_fn(|l| 0.6 + 0.4 * ((3 * block + l) as f32).sin()));
            network.step(&mut tape, block, &log, &mut outputs);
            for (n, output) in outputs.iter().enumerate() {
                total += (0..LANES).map(|l| f64::from(weight(block, n)[l] * output[l])).sum::<f64>();
            }
        }
        (network, tape, total)
    }

    #[test]
    fn gradients_by_parameters_agree_with_finite_differences() {
        let timing = Timing::for_period(1000, 1);
        let shape =
            RecurrentShape { timing, states: 3, hidden: 4, history: 2, known: 2, constants: 1, outputs: 2 };
        let parameters = shape.initialise(1.0, &mut ChaCha8Rng::seed_from_u64(7));
        let (network, mut tape, _) = breathe(shape, &parameters);
        let mut d_log = CommandLog::new(BLOCKS, vec![Lane::ZERO; timing.width()]);
        for block in (0..BLOCKS).rev() {
            network.step_back(&mut tape, block, |n| weight(block, n), &mut d_log);
        }
        let mut gradient = vec![0.0; parameters.len()];
        network.finish(&tape, &mut gradient);
        check_slopes("parameter", &parameters, 5e-3, &gradient, |varied| breathe(shape, varied).2);
    }
}
