//! The authors' simulator: networks stitched together in time (Suo et al. 2021; constants of their code).
//!
//! The last five commands (including the present one) and the last pressures give the next pressure. Each of the first
//! five steps of a breath has its own *boundary* network (tanh, five pressures); all later steps share a deep network
//! (SELU, three pressures). Missing history is filled with scaled zeros. The simulator advances one control tick at a
//! time, 30 ms in the paper.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::layers::{Layers, LayersTape};

use super::{BreathStart, CommandLog, Dynamics, PRESSURE_SCALE, Timing};
use engine::Lane;
use engine::activation::Activation;
use engine::dense::DenseLayer;

/// Number of commands that a step sees.
pub(crate) const COMMANDS: usize = 5;
/// Number of pressures that a boundary network sees.
pub(crate) const PRESSURES: usize = 5;
/// Number of pressures that the shared network sees.
pub(crate) const PRESSURES_SHARED: usize = 3;
/// Number of steps with their own network.
pub(crate) const BOUNDARIES: usize = 5;
/// Number of inputs of every network.
const INPUTS: usize = COMMANDS + PRESSURES;
/// Number of units of every hidden layer.
const HIDDEN: usize = 100;
/// Number of hidden layers of the shared network.
const DEPTH: usize = 3;
/// Total number of layers: two per boundary network, and those of the shared one with its output.
const LAYERS: usize = 2 * BOUNDARIES + DEPTH + 1;

/// Shape of the model; everything except the timing is fixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StitchedConfig {
    /// Division of time into blocks: one tick per block.
    pub timing: Timing,
}

impl StitchedConfig {
    /// The shape for a control period in microseconds.
    pub fn for_period(period_us: u32) -> Self {
        Self { timing: Timing { period_us, block_ticks: 1, parts: 1, points: 1, channels: 1 } }
    }

    pub(crate) fn layout() -> ([DenseLayer; LAYERS], usize) {
        DenseLayer::layout(std::array::from_fn(|n| match n {
            n if n < 2 * BOUNDARIES && n % 2 == 0 => (INPUTS, HIDDEN),
            n if n < 2 * BOUNDARIES => (HIDDEN, 1),
            n if n == 2 * BOUNDARIES => (INPUTS, HIDDEN),
            n if n < LAYERS - 1 => (HIDDEN, HIDDEN),
            _ => (HIDDEN, 1),
        }))
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        Self::layout().1
    }

    /// Draws initial parameters.
    pub fn initialise(self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let (layers, total) = Self::layout();
        let mut parameters = vec![0.0; total];
        for layer in layers {
            layer.initialise(&mut parameters, 1.0, rng);
        }
        parameters
    }
}

/// The model with its parameters, ready to run.
#[derive(Clone, Debug)]
pub(super) struct Stitched {
    /// The boundary networks, then the shared one.
    networks: Vec<Layers>,
}

/// Forward values and backward gradients of a rollout.
#[derive(Clone, Debug)]
pub(super) struct StitchedTape {
    /// Scaled pressures at the start of each step: predictions or, in one-step training, measurements.
    pressures: Vec<Lane>,
    d_pressures: Vec<Lane>,
    /// One tape per step.
    steps: Vec<LayersTape>,
    measured: bool,
}

impl Stitched {
    /// A model from its parameters.
    ///
    /// # Panics
    /// If `parameters` does not have [`StitchedConfig::parameters`] entries.
    pub fn new(parameters: &[f32]) -> Self {
        let (layers, total) = StitchedConfig::layout();
        assert_eq!(parameters.len(), total, "parameters of another shape");
        let (boundaries, shared) = layers.split_at(2 * BOUNDARIES);
        let boundaries = boundaries.chunks(2).map(|layers| Layers::new(layers, Activation::Tanh, parameters));
        let shared = Layers::new(shared, Activation::Selu, parameters);
        Self { networks: boundaries.chain([shared]).collect() }
    }

    fn network(&self, step: usize) -> &Layers {
        &self.networks[step.min(BOUNDARIES)]
    }

    fn pressures_seen(step: usize) -> usize {
        if step < BOUNDARIES { PRESSURES } else { PRESSURES_SHARED }
    }
}

fn scale(pressure: f32) -> f32 {
    (pressure - PRESSURE_SCALE.0) / PRESSURE_SCALE.1
}

impl Dynamics for Stitched {
    type Tape = StitchedTape;

    fn tape(&self, blocks: usize) -> StitchedTape {
        StitchedTape {
            pressures: vec![Lane::ZERO; blocks + 1],
            d_pressures: vec![Lane::ZERO; blocks + 1],
            steps: (0..blocks).map(|step| self.network(step).tape(1)).collect(),
            measured: false,
        }
    }

    fn begin(&self, tape: &mut StitchedTape, start: &BreathStart) {
        tape.pressures[0] = start.pressure.map(scale);
        tape.d_pressures.fill(Lane::ZERO);
        tape.measured = false;
    }

    fn step(&self, tape: &mut StitchedTape, block: usize, log: &CommandLog, points: &mut [Lane]) {
        let input = tape.steps[block].inputs(0);
        input.fill(Lane::ZERO);
        for (age, input) in input[..COMMANDS].iter_mut().enumerate().take(block + 1) {
            *input = log.block(Some(block - age))[0];
        }
        let seen = Self::pressures_seen(block).min(block + 1);
        for (age, input) in input[COMMANDS..].iter_mut().enumerate().take(seen) {
            *input = tape.pressures[block - age];
        }
        let next = self.network(block).forward(&mut tape.steps[block], 0);
        tape.pressures[block + 1] = next;
        points[0] = next.map(|y| PRESSURE_SCALE.0 + PRESSURE_SCALE.1 * y);
    }

    fn step_back(&self, tape: &mut StitchedTape, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let carried = if tape.measured { Lane::ZERO } else { tape.d_pressures[block + 1] };
        let d_next = d_points[0].zip(&carried, |d, c| PRESSURE_SCALE.1 * d + c);
        let d_input = self.network(block).backward(&mut tape.steps[block], 0, d_next);
        for (age, d) in d_input[..COMMANDS].iter().enumerate().take(block + 1) {
            d_log.block_mut(block - age)[0].add_scaled(1.0, d);
        }
        let seen = Self::pressures_seen(block).min(block + 1);
        for (age, d) in d_input[COMMANDS..].iter().enumerate().take(seen) {
            tape.d_pressures[block - age].add_scaled(1.0, d);
        }
    }

    fn teach(&self, tape: &mut StitchedTape, block: usize, measured: &Lane) {
        tape.measured = true;
        tape.pressures[block + 1] = measured.map(scale);
    }

    fn finish(&self, tape: &mut StitchedTape, gradient: &mut [f32]) {
        for (step, tape) in tape.steps.iter().enumerate() {
            self.network(step).finish(tape, gradient);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::model::Architecture;
    use crate::simulator::tests_support::check_gradients;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn gradients_of_a_rollout_agree_with_finite_differences() {
        let config = StitchedConfig::for_period(30_000);
        let parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(3));
        check_gradients(Architecture::Stitched(config), &parameters);
    }

    #[test]
    fn the_networks_have_the_papers_shapes() {
        let boundary = INPUTS * HIDDEN + HIDDEN + HIDDEN + 1;
        let shared = INPUTS * HIDDEN + HIDDEN + 2 * (HIDDEN * HIDDEN + HIDDEN) + HIDDEN + 1;
        assert_eq!(StitchedConfig::for_period(30_000).parameters(), 5 * boundary + shared);
    }
}
