//! Leaky states, each with a time constant, driven by an affine map of their inputs: `c' = a c + (1 - a) (W v + b)`
//! with `a = sigmoid(decay)`. At the start of a breath they are set by an affine map of the known quantities.

use engine::Lane;
use engine::dense::{DenseLayer, DenseWeights};

use super::block::Block;
use super::{piece, piece_mut};
use crate::graph::state::State;
use crate::graph::{Builder, Value};

/// Parameters of the states.
#[derive(Clone, Debug)]
pub(super) struct LeakyStates {
    start: DenseWeights,
    drive: DenseWeights,
    decay_offset: usize,
    /// `a` of each state.
    keep: Vec<f32>,
}

/// Forward values and backward gradients of a rollout, block by block.
#[derive(Clone, Debug)]
pub(super) struct LeakyTape {
    known: Vec<Lane>,
    /// `W v + b` of each block.
    drive: Vec<Lane>,
    d_drive: Vec<Lane>,
    d_decay: Vec<Lane>,
    /// Gradient with respect to the states after the block that the backward pass visits next.
    pub d_state: Vec<Lane>,
}

impl LeakyStates {
    /// From a parameter vector: layers, and the index of the first decay.
    pub fn new(start: &DenseLayer, drive: &DenseLayer, decay_offset: usize, parameters: &[f32]) -> Self {
        let decays = &parameters[decay_offset..decay_offset + drive.outputs];
        Self {
            start: start.load(parameters),
            drive: drive.load(parameters),
            decay_offset,
            keep: decays.iter().map(|decay| sigmoid(*decay)).collect(),
        }
    }

    /// Memory for a rollout of `blocks` blocks.
    pub fn tape(&self, blocks: usize) -> LeakyTape {
        let zeros = |length: usize| vec![Lane::ZERO; length];
        let states = self.keep.len();
        LeakyTape {
            known: zeros(self.start.shape().inputs),
            drive: zeros(blocks * states),
            d_drive: zeros(blocks * states),
            d_decay: zeros(states),
            d_state: zeros(states),
        }
    }

    /// Starts a breath: sets `states` from the known quantities.
    pub fn begin(&self, tape: &mut LeakyTape, known: &[Lane], states: &mut [Lane]) {
        tape.known.copy_from_slice(known);
        self.start.forward(known, states);
        tape.d_state.fill(Lane::ZERO);
        tape.d_decay.fill(Lane::ZERO);
    }

    /// States after a block, from the states before it and its inputs.
    pub fn step(
        &self,
        tape: &mut LeakyTape,
        block: usize,
        before: &[Lane],
        inputs: &[Lane],
        after: &mut [Lane],
    ) {
        let drive = piece_mut(&mut tape.drive, block, self.keep.len());
        self.drive.forward(inputs, drive);
        for (s, keep) in self.keep.iter().enumerate() {
            after[s] = before[s].zip(&drive[s], |c, g| keep * c + (1.0 - keep) * g);
        }
    }

    /// Backward pass: takes the outputs' part of the gradient of the states after the block, sets the inputs' gradient,
    /// and leaves that of the states before the block in the tape.
    pub fn step_back(
        &self,
        tape: &mut LeakyTape,
        block: usize,
        before: &[Lane],
        d_after: &[Lane],
        d_inputs: &mut [Lane],
    ) {
        let drive = piece(&tape.drive, block, self.keep.len());
        let d_drive = piece_mut(&mut tape.d_drive, block, self.keep.len());
        for (s, keep) in self.keep.iter().enumerate() {
            let d = &mut tape.d_state[s];
            d.add_scaled(1.0, &d_after[s]);
            let difference = before[s].zip(&drive[s], |c, g| keep * (1.0 - keep) * (c - g));
            tape.d_decay[s].add_scaled(1.0, &d.zip(&difference, |d, x| d * x));
            d_drive[s] = d.map(|d| (1.0 - keep) * d);
            *d = d.map(|d| keep * d);
        }
        self.drive.backward(d_drive, d_inputs);
    }

    /// Adds the parameters' gradient, given the inputs of all blocks, after the backward pass of all blocks.
    pub fn finish(&self, tape: &LeakyTape, inputs: &[Lane], gradient: &mut [f32]) {
        self.drive.shape().gradient(&tape.d_drive, inputs, gradient);
        self.start.shape().gradient(&tape.d_state, &tape.known, gradient);
        for (gradient, d) in gradient[self.decay_offset..].iter_mut().zip(&tape.d_decay) {
            *gradient += d.sum();
        }
    }
}

/// The logistic function.
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// [`LeakyStates::begin`] as a graph; the state has a piece `states`.
pub(super) fn begin_graph(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    (start, parameters): (&DenseLayer, &[f32]),
    known: &Value,
) {
    let begun = graph.layer(known, start, parameters);
    state.set_where(graph, &block.begins, "states", &begun);
}

/// [`LeakyStates::step`] as a graph: the states after a block, driven by these inputs.
pub(super) fn step_graph(
    graph: &mut Builder,
    state: &mut State,
    (drive, parameters): (&DenseLayer, &[f32]),
    decays: &[f32],
    inputs: &Value,
) -> Value {
    let keep: Vec<f32> = decays.iter().map(|decay| sigmoid(*decay)).collect();
    let rest: Vec<f32> = keep.iter().map(|keep| 1.0 - keep).collect();
    let (keep, rest) = (graph.row(&keep), graph.row(&rest));
    let driven = graph.layer(inputs, drive, parameters);
    let kept = graph.mul(&keep, &state.get("states"));
    let driven = graph.mul(&rest, &driven);
    let after = graph.add(&kept, &driven);
    state.set("states", after.clone());
    after
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;

    const BLOCKS: usize = 3;
    const WEIGHTS: [f32; 2] = [2.0, -3.0];

    /// Two states driven by one input, started from one known number; the weighted sum of all states.
    fn run(at: &[f32]) -> (LeakyStates, LeakyTape, Vec<Lane>, f64) {
        let ([drive, start], decay) = DenseLayer::layout([(1, 2), (1, 2)]);
        let leaky = LeakyStates::new(&start, &drive, decay, at);
        let (mut tape, mut states) = (leaky.tape(BLOCKS), vec![Lane::ZERO; 2 * (BLOCKS + 1)]);
        leaky.begin(&mut tape, &[Lane::splat(0.7)], &mut states[..2]);
        let mut total = 0.0;
        for block in 0..BLOCKS {
            let (before, after) = states.split_at_mut(2 * (block + 1));
            leaky.step(&mut tape, block, &before[2 * block..], &[inputs()[block]], after);
            total += after.iter().zip(WEIGHTS).map(|(c, weight)| f64::from(c[0] * weight)).sum::<f64>();
        }
        (leaky, tape, states, total)
    }

    fn inputs() -> [Lane; BLOCKS] {
        [0.4, -0.8, 1.2].map(Lane::splat)
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let at = [0.5, -0.9, 0.2, 0.1, -0.3, 0.8, 0.6, -0.2, -0.5, 1.5];
        let (leaky, mut tape, states, _) = run(&at);
        // All lanes are equal; the sum over them counts once.
        let d_after = WEIGHTS.map(|weight| Lane::splat(weight / engine::LANES as f32));
        for block in (0..BLOCKS).rev() {
            leaky.step_back(&mut tape, block, &states[2 * block..], &d_after, &mut [Lane::ZERO]);
        }
        let mut gradient = vec![0.0; at.len()];
        leaky.finish(&tape, &inputs(), &mut gradient);
        check_slopes("parameter", &at, 1e-2, &gradient, |at| run(at).3);
    }
}
