//! The authors' simulator: networks stitched together in time (Suo et al. 2021; constants of their code).
//!
//! The last five commands (including the present one) and the last pressures give the next pressure. Each of the first
//! five steps of a breath has its own *boundary* network (tanh, five pressures); all later steps share a deep network
//! (SELU, three pressures). Missing history is filled with scaled zeros. The simulator advances one control tick at a
//! time, 30 ms in the paper. In its graph all networks are computed in each step, and the one whose turn it is counts.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::block::{Block, commands_seen, pressures};
use super::design::{Design, Dynamics};
use super::fit_config::FitConfig;
use super::shape::ShapeError;
use super::{BreathStart, CommandLog, PRESSURE_SCALE, Timing};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use crate::layers::{Layers, LayersTape};
use engine::Lane;
use engine::activation::Activation;
use engine::dense::DenseLayer;

/// Number of commands that a step sees.
const COMMANDS: usize = 5;
/// Number of pressures that a boundary network sees.
const PRESSURES: usize = 5;
/// Number of pressures that the shared network sees.
const PRESSURES_SHARED: usize = 3;
/// Number of steps with their own network.
const BOUNDARIES: usize = 5;
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

    fn layout() -> ([DenseLayer; LAYERS], usize) {
        DenseLayer::layout(std::array::from_fn(|n| match n {
            n if n < 2 * BOUNDARIES && n % 2 == 0 => (INPUTS, HIDDEN),
            n if n < 2 * BOUNDARIES => (HIDDEN, 1),
            n if n == 2 * BOUNDARIES => (INPUTS, HIDDEN),
            n if n < LAYERS - 1 => (HIDDEN, HIDDEN),
            _ => (HIDDEN, 1),
        }))
    }
}

impl Design for StitchedConfig {
    fn timing(&self) -> &Timing {
        &self.timing
    }

    fn parameters(&self) -> usize {
        Self::layout().1
    }

    fn check(&self) -> Result<(), ShapeError> {
        self.timing.check()?;
        self.timing.check_single_ticks()
    }

    fn fitting(&self) -> (FitConfig, Option<usize>) {
        (FitConfig::authors(), None)
    }

    fn dynamics(&self, parameters: &[f32], blocks: usize) -> Box<dyn Dynamics> {
        let networks = networks(parameters);
        Box::new(Stitched {
            pressures: vec![Lane::ZERO; blocks + 1],
            d_pressures: vec![Lane::ZERO; blocks + 1],
            steps: (0..blocks).map(|step| networks[step.min(BOUNDARIES)].tape(1)).collect(),
            measured: false,
            networks,
        })
    }

    fn graph(&self, graph: &mut Builder, block: &Block, parameters: &[f32]) -> (Value, State) {
        let pieces = [("commands", COMMANDS), ("pressures", PRESSURES), ("pressure", 1), ("step", 1)];
        let mut state = State::input(graph, &pieces);
        begin_graph(graph, &mut state, block);
        // The networks know nothing of the command before the breath.
        let none = graph.number(0.0);
        let commands = commands_seen(graph, &mut state, block, (&self.timing, COMMANDS), &none);
        let past = state.get("pressures");
        let next = networks_graph(graph, &state, &commands, &past, parameters);
        let past = graph.pushed(&next, &past, PRESSURES);
        state.set("pressures", past);
        let step = graph.shift(&state.get("step"), 1.0);
        state.set("step", step);
        let (mean, scale) = PRESSURE_SCALE;
        let point = graph.scale(&next, scale);
        let point = graph.shift(&point, mean);
        (pressures(graph, &mut state, block, &self.timing, &[point]), state)
    }

    fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let (layers, total) = Self::layout();
        let mut parameters = vec![0.0; total];
        for layer in layers {
            layer.initialise(&mut parameters, 1.0, rng);
        }
        parameters
    }
}

/// The model with its parameters, and the forward values and backward gradients of a rollout.
#[derive(Debug)]
struct Stitched {
    /// The boundary networks, then the shared one.
    networks: Vec<Layers>,
    /// Scaled pressures at the start of each step: predictions or, in one-step training, measurements.
    pressures: Vec<Lane>,
    d_pressures: Vec<Lane>,
    /// One tape per step.
    steps: Vec<LayersTape>,
    measured: bool,
}

/// The networks of a parameter vector.
fn networks(parameters: &[f32]) -> Vec<Layers> {
    let (layers, _) = StitchedConfig::layout();
    let (boundaries, shared) = layers.split_at(2 * BOUNDARIES);
    let boundaries = boundaries.chunks(2).map(|layers| Layers::new(layers, Activation::Tanh, parameters));
    let shared = Layers::new(shared, Activation::Selu, parameters);
    boundaries.chain([shared]).collect()
}

/// Number of pressures that a step sees.
fn pressures_seen(step: usize) -> usize {
    (if step < BOUNDARIES { PRESSURES } else { PRESSURES_SHARED }).min(step + 1)
}

fn scale(pressure: f32) -> f32 {
    (pressure - PRESSURE_SCALE.0) / PRESSURE_SCALE.1
}

impl Dynamics for Stitched {
    fn load(&mut self, parameters: &[f32]) {
        self.networks = networks(parameters);
    }

    fn begin(&mut self, start: &BreathStart) {
        self.pressures[0] = start.pressure.map(scale);
        self.d_pressures.fill(Lane::ZERO);
        self.measured = false;
    }

    fn step(&mut self, block: usize, log: &CommandLog, points: &mut [Lane]) {
        let input = self.steps[block].inputs(0);
        input.fill(Lane::ZERO);
        for (age, input) in input[..COMMANDS].iter_mut().enumerate().take(block + 1) {
            *input = log.block(Some(block - age))[0];
        }
        for (age, input) in input[COMMANDS..].iter_mut().enumerate().take(pressures_seen(block)) {
            *input = self.pressures[block - age];
        }
        let next = self.networks[block.min(BOUNDARIES)].forward(&mut self.steps[block], 0);
        self.pressures[block + 1] = next;
        points[0] = next.map(|y| PRESSURE_SCALE.0 + PRESSURE_SCALE.1 * y);
    }

    fn step_back(&mut self, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let carried = if self.measured { Lane::ZERO } else { self.d_pressures[block + 1] };
        let d_next = d_points[0].zip(&carried, |d, c| PRESSURE_SCALE.1 * d + c);
        let d_input = self.networks[block.min(BOUNDARIES)].backward(&mut self.steps[block], 0, d_next);
        for (age, d) in d_input[..COMMANDS].iter().enumerate().take(block + 1) {
            d_log.block_mut(block - age)[0].add_scaled(1.0, d);
        }
        for (age, d) in d_input[COMMANDS..].iter().enumerate().take(pressures_seen(block)) {
            self.d_pressures[block - age].add_scaled(1.0, d);
        }
    }

    fn teach(&mut self, block: usize, measured: &Lane) {
        self.measured = true;
        self.pressures[block + 1] = measured.map(scale);
    }

    fn finish(&self, gradient: &mut [f32]) {
        for (step, tape) in self.steps.iter().enumerate() {
            self.networks[step.min(BOUNDARIES)].finish(tape, gradient);
        }
    }
}

/// Starts a breath: one pressure is known, and no step has been run.
fn begin_graph(graph: &mut Builder, state: &mut State, block: &Block) {
    let (mean, scale) = PRESSURE_SCALE;
    let pressure = graph.shift(block.pressure(), -mean);
    let one = graph.number(scale);
    let pressure = graph.div(&pressure, &one);
    let missing = graph.row(&[0.0; PRESSURES - 1]);
    let counted = graph.scale(&pressure, 0.0);
    let missing = graph.add(&missing, &counted);
    let known = graph.join(&[&pressure, &missing]);
    state.set_where(graph, &block.begins, "pressures", &known);
    let step = graph.cleared(&block.begins, &state.get("step"));
    state.set("step", step);
}

/// The next scaled pressure, from the network of the step.
fn networks_graph(
    graph: &mut Builder,
    state: &State,
    commands: &Value,
    past: &Value,
    parameters: &[f32],
) -> Value {
    let (layers, _) = StitchedConfig::layout();
    let (boundaries, shared) = layers.split_at(2 * BOUNDARIES);
    let known: Vec<f32> = (0..PRESSURES).map(|age| if age < PRESSURES_SHARED { 1.0 } else { 0.0 }).collect();
    let known = graph.row(&known);
    let few = graph.mul(past, &known);
    let (inputs, few) = (graph.join(&[commands, past]), graph.join(&[commands, &few]));
    let mut next = stack_graph(graph, few, shared, "Selu", parameters);
    for (number, layers) in boundaries.chunks(2).enumerate().rev() {
        let own = stack_graph(graph, inputs.clone(), layers, "Tanh", parameters);
        let bound = graph.number(number as f32 + 0.5);
        let turn = graph.less(&state.get("step"), &bound);
        next = graph.choose(&turn, &own, &next);
    }
    next
}

/// Layers with an activation between them.
fn stack_graph(
    graph: &mut Builder,
    inputs: Value,
    layers: &[DenseLayer],
    activation: &str,
    parameters: &[f32],
) -> Value {
    let mut value = inputs;
    for (n, layer) in layers.iter().enumerate() {
        value = graph.layer(&value, layer, parameters);
        if n + 1 < layers.len() {
            value = graph.op(activation, &[&value]);
        }
    }
    value
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
