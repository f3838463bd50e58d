//! The authors' simulator: networks stitched together in time (Suo et al. 2021; constants of their code).
//!
//! The last five commands (the present one included) and the last pressures give the next pressure. The first
//! five steps of a breath have a *boundary* network each (tanh, five pressures); all later ones share a deep
//! network (SELU, three pressures). A history shorter than that is filled with scaled zeros. It goes one control
//! tick at a time, 30 ms in the paper.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{BreathStart, CommandLog, Dynamics, PRESSURE_SCALE, Timing};
use engine::Lane;
use engine::activation::Activation;
use engine::dense::{DenseLayer, DenseWeights};

/// Commands that a step sees.
const COMMANDS: usize = 5;
/// Pressures that a boundary network sees.
const PRESSURES: usize = 5;
/// Pressures that the shared network sees.
const PRESSURES_SHARED: usize = 3;
/// Steps with a network of their own.
const BOUNDARIES: usize = 5;
/// Inputs of every network.
const INPUTS: usize = COMMANDS + PRESSURES;
/// Units of every hidden layer.
const HIDDEN: usize = 100;
/// Hidden layers of the shared network.
const DEPTH: usize = 3;
/// Layers in all: two per boundary network, those of the shared one and its output.
const LAYERS: usize = 2 * BOUNDARIES + DEPTH + 1;

/// Shape of the model; everything but time is fixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StitchedConfig {
    /// How time is cut: one tick per block.
    pub timing: Timing,
}

impl StitchedConfig {
    /// The shape for a control period in microseconds.
    pub fn for_period(period_us: u32) -> Self {
        Self { timing: Timing { period_us, block_ticks: 1, parts: 1, points: 1, channels: 1 } }
    }

    fn layout() -> ([DenseLayer; LAYERS], usize) {
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

    /// Draws parameters.
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
pub struct Stitched {
    config: StitchedConfig,
    layers: Vec<DenseWeights>,
}

/// Forward values and backward gradients of a rollout.
#[derive(Clone, Debug)]
pub struct StitchedTape {
    /// Scaled pressures at the start of each step, own predictions or, in one-step training, measured ones.
    pressures: Vec<Lane>,
    d_pressures: Vec<Lane>,
    /// Input, hidden layers and output of each step, and the gradients behind them.
    values: Vec<Vec<Vec<Lane>>>,
    gradients: Vec<Vec<Vec<Lane>>>,
    measured: bool,
}

impl Stitched {
    /// A model from its parameters.
    ///
    /// # Panics
    /// If `parameters` does not have [`StitchedConfig::parameters`] entries.
    pub fn new(config: StitchedConfig, parameters: &[f32]) -> Self {
        let (layers, total) = StitchedConfig::layout();
        assert_eq!(parameters.len(), total, "parameters of another shape");
        Self { config, layers: layers.iter().map(|layer| layer.load(parameters)).collect() }
    }

    /// Layers and activation of a step's network.
    fn network(&self, step: usize) -> (&[DenseWeights], Activation) {
        if step < BOUNDARIES {
            (&self.layers[2 * step..2 * step + 2], Activation::Tanh)
        } else {
            (&self.layers[2 * BOUNDARIES..], Activation::Selu)
        }
    }

    fn pressures_seen(step: usize) -> usize {
        if step < BOUNDARIES { PRESSURES } else { PRESSURES_SHARED }
    }

    /// Its shape.
    pub fn config(&self) -> &StitchedConfig {
        &self.config
    }
}

fn scale(pressure: f32) -> f32 {
    (pressure - PRESSURE_SCALE.0) / PRESSURE_SCALE.1
}

impl Dynamics for Stitched {
    type Tape = StitchedTape;

    fn timing(&self) -> &Timing {
        &self.config.timing
    }

    fn parameters(&self) -> usize {
        self.config.parameters()
    }

    fn tape(&self, blocks: usize) -> StitchedTape {
        let memory: Vec<Vec<Vec<Lane>>> = (0..blocks)
            .map(|step| {
                let outputs = self.network(step).0.iter().map(|layer| layer.shape().outputs);
                std::iter::once(INPUTS).chain(outputs).map(|width| vec![Lane::ZERO; width]).collect()
            })
            .collect();
        StitchedTape {
            pressures: vec![Lane::ZERO; blocks + 1],
            d_pressures: vec![Lane::ZERO; blocks + 1],
            gradients: memory.clone(),
            values: memory,
            measured: false,
        }
    }

    fn begin(&self, tape: &mut StitchedTape, start: &BreathStart) {
        tape.pressures[0] = start.pressure.map(scale);
        tape.d_pressures.fill(Lane::ZERO);
        tape.measured = false;
    }

    fn step(&self, tape: &mut StitchedTape, block: usize, log: &CommandLog, points: &mut [Lane]) {
        let (layers, activation) = self.network(block);
        let values = &mut tape.values[block];
        let input = &mut values[0];
        input.fill(Lane::ZERO);
        for (age, input) in input[..COMMANDS].iter_mut().enumerate().take(block + 1) {
            *input = log.block(Some(block - age))[0];
        }
        let seen = Self::pressures_seen(block).min(block + 1);
        for (age, input) in input[COMMANDS..].iter_mut().enumerate().take(seen) {
            *input = tape.pressures[block - age];
        }
        for (n, layer) in layers.iter().enumerate() {
            let (before, after) = values.split_at_mut(n + 1);
            layer.forward(&before[n], &mut after[0]);
            if n + 1 < layers.len() {
                activation.forward(&mut after[0]);
            }
        }
        let next = values[layers.len()][0];
        tape.pressures[block + 1] = next;
        points[0] = next.map(|y| PRESSURE_SCALE.0 + PRESSURE_SCALE.1 * y);
    }

    fn step_back(&self, tape: &mut StitchedTape, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let (layers, activation) = self.network(block);
        let (values, gradients) = (&tape.values[block], &mut tape.gradients[block]);
        let carried = if tape.measured { Lane::ZERO } else { tape.d_pressures[block + 1] };
        gradients[layers.len()][0] = d_points[0].zip(&carried, |d, c| PRESSURE_SCALE.1 * d + c);
        for (n, layer) in layers.iter().enumerate().rev() {
            let (before, after) = gradients.split_at_mut(n + 1);
            layer.backward(&after[0], &mut before[n]);
            if n > 0 {
                activation.backward(&values[n], &mut before[n]);
            }
        }
        let d_input = &gradients[0];
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
        for (step, (values, gradients)) in tape.values.iter().zip(&tape.gradients).enumerate() {
            for (n, layer) in self.network(step).0.iter().enumerate() {
                layer.shape().gradient(&gradients[n + 1], &values[n], gradient);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::tests_support::check_gradients;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn gradients_of_a_rollout_agree_with_finite_differences() {
        let config = StitchedConfig::for_period(30_000);
        let parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(3));
        check_gradients(&parameters, |p| Stitched::new(config, p));
    }

    #[test]
    fn the_networks_have_the_papers_shapes() {
        let boundary = INPUTS * HIDDEN + HIDDEN + HIDDEN + 1;
        let shared = INPUTS * HIDDEN + HIDDEN + 2 * (HIDDEN * HIDDEN + HIDDEN) + HIDDEN + 1;
        assert_eq!(StitchedConfig::for_period(30_000).parameters(), 5 * boundary + shared);
    }
}
