//! Our simulator: a nonlinear state-space model.
//!
//! States are leaky integrators with learned time constants, driven by past commands and by a hidden layer that sees
//! states and commands (`recurrent.rs`); outputs are pressures at the block's points, `20 + 10 y`. Slow linear states
//! represent the lung's volume, fast ones the valve's lag; the hidden layer adds the nonlinearity.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::block::{Block, commands_seen, known, pressures};
use super::design::{Design, Dynamics};
use super::recurrent::{RecurrentNetwork, RecurrentShape, RecurrentTape, step_graph};
use super::shape::{ShapeError, widths};
use super::{BreathStart, CommandLog, PRESSURE_SCALE, Timing, USUAL_LUNG};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use data::identity::LungParameters;
use engine::Lane;

/// Quantities known at the start of a breath: pressure, last plateau; in a model of many lungs also their commands.
const START_INPUTS: usize = 2;
const START_INPUTS_OF_LUNGS: usize = 4;
/// Inputs that describe the lung in a model of many lungs: logarithms of R and C over 20.
const LUNG_INPUTS: usize = 2;
/// Initial time constant of the slowest state, s.
const LONGEST_S: f32 = 3.0;

/// Shape of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StateSpaceConfig {
    /// Division of time into blocks.
    pub timing: Timing,
    /// Number of states.
    pub states: usize,
    /// Number of hidden units.
    pub hidden: usize,
    /// Number of past command blocks that a step sees.
    pub history: usize,
    /// Whether the model covers many lungs, with the nominal R and C of each as inputs.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub lungs: bool,
}

impl StateSpaceConfig {
    /// The default shape for a control period in microseconds and this number of command channels.
    pub fn for_period(period_us: u32, channels: usize) -> Self {
        Self {
            timing: Timing::for_period(period_us, channels),
            states: 16,
            hidden: 64,
            history: 4,
            lungs: false,
        }
    }

    fn shape(&self) -> RecurrentShape {
        let Self { timing, states, hidden, history, lungs } = *self;
        RecurrentShape {
            timing,
            states,
            hidden,
            history,
            known: if lungs { START_INPUTS_OF_LUNGS } else { START_INPUTS },
            constants: if lungs { LUNG_INPUTS } else { 0 },
            outputs: timing.points,
        }
    }
}

impl Design for StateSpaceConfig {
    fn timing(&self) -> &Timing {
        &self.timing
    }

    fn parameters(&self) -> usize {
        self.shape().parameters()
    }

    fn check(&self) -> Result<(), ShapeError> {
        self.timing.check()?;
        widths(self.states, self.hidden, self.history)
    }

    fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        self.shape().initialise(LONGEST_S, rng)
    }

    fn many_lungs(&self) -> bool {
        self.lungs
    }

    fn dynamics(&self, parameters: &[f32], blocks: usize) -> Box<dyn Dynamics> {
        let network = RecurrentNetwork::new(self.shape(), parameters);
        Box::new(StateSpace { shape: self.shape(), tape: network.tape(blocks), network })
    }

    fn graph(&self, graph: &mut Builder, block: &Block, parameters: &[f32]) -> (Value, State) {
        let (shape, timing) = (self.shape(), &self.timing);
        let pieces = [("commands", self.history * timing.width()), ("states", self.states), ("pressure", 1)];
        let mut state = State::input(graph, &pieces);
        let [rest, _] = block.rest(graph);
        let seen = commands_seen(graph, &mut state, block, (timing, self.history), &rest);
        let known = known(graph, block, shape.known);
        let constants = (shape.constants > 0).then(|| lung_graph(graph, block));
        let outputs =
            step_graph(graph, &mut state, block, (&shape, parameters), &known, (&seen, constants.as_ref()));
        let (mean, scale) = PRESSURE_SCALE;
        let points = graph.scale(&outputs, scale);
        let points = graph.shift(&points, mean);
        let points = graph.split(&points, &vec![1; timing.points]);
        (pressures(graph, &mut state, block, timing, &points), state)
    }
}

/// The inputs that describe the lung, as a graph.
fn lung_graph(graph: &mut Builder, block: &Block) -> Value {
    let usual = [USUAL_LUNG.resistance, USUAL_LUNG.compliance];
    let [resistance, compliance] = [0, 1].map(|n| {
        let usual = graph.number(usual[n]);
        let ratio = graph.div(block.lung()[n], &usual);
        graph.op("Log", &[&ratio])
    });
    graph.join(&[&resistance, &compliance])
}

/// The model with its parameters and the memory of a rollout.
#[derive(Debug)]
struct StateSpace {
    shape: RecurrentShape,
    network: RecurrentNetwork,
    tape: RecurrentTape,
}

impl Dynamics for StateSpace {
    fn load(&mut self, parameters: &[f32]) {
        self.network = RecurrentNetwork::new(self.shape, parameters);
    }

    fn begin(&mut self, start: &BreathStart) {
        let LungParameters { resistance, compliance } = USUAL_LUNG;
        let lung: [Lane; LUNG_INPUTS] = [
            start.resistance.map(|r| (r / resistance).ln()),
            start.compliance.map(|c| (c / compliance).ln()),
        ];
        let RecurrentShape { known, constants, .. } = self.shape;
        self.network.begin(&mut self.tape, &start.known()[..known], &lung[..constants]);
    }

    fn step(&mut self, block: usize, log: &CommandLog, points: &mut [Lane]) {
        self.network.step(&mut self.tape, block, log, points);
        let (mean, scale) = PRESSURE_SCALE;
        for point in points {
            *point = point.map(|y| mean + scale * y);
        }
    }

    fn step_back(&mut self, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let d_output = |n: usize| d_points[n].map(|d| PRESSURE_SCALE.1 * d);
        self.network.step_back(&mut self.tape, block, d_output, d_log);
    }

    fn finish(&self, gradient: &mut [f32]) {
        self.network.finish(&self.tape, gradient);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::model::Architecture;
    use crate::simulator::tests_support::check_gradients;
    use engine::LANES;
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
            check_gradients(Architecture::StateSpace(config), &parameters);
        }
    }

    #[test]
    fn commands_of_the_running_block_cannot_be_felt_in_it() {
        let config = StateSpaceConfig::for_period(1000, 1);
        let parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(4));
        let last_point = |command: f32, block: usize| {
            let (mut model, mut points) = (config.dynamics(&parameters, 6), vec![Lane::ZERO; 2]);
            let mut log = CommandLog::new(6, vec![Lane::ZERO; 2]);
            log.block_mut(block).fill(Lane::splat(command));
            model.begin(&BreathStart::default());
            for block in 0..6 {
                model.step(block, &log, &mut points);
            }
            points[1][LANES - 1]
        };
        assert_eq!(last_point(0.0, 5).to_bits(), last_point(1.0, 5).to_bits());
        assert!((last_point(0.0, 4) - last_point(1.0, 4)).abs() > 1e-4);
    }
}
