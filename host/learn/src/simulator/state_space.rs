//! Our simulator: a nonlinear state-space model.
//!
//! States are leaky integrators with learned time constants, driven by past commands and by a hidden layer that sees
//! states and commands (`recurrent.rs`); outputs are pressures at the block's points, `20 + 10 y`. Slow linear states
//! represent the lung's volume, fast ones the valve's lag; the hidden layer adds the nonlinearity.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::recurrent::{RecurrentNetwork, RecurrentShape, RecurrentTape};
use super::{BreathStart, CommandLog, Dynamics, PRESSURE_SCALE, Timing, USUAL_LUNG};
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

    pub(crate) fn shape(&self) -> RecurrentShape {
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

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.shape().parameters()
    }

    /// Draws initial parameters.
    pub fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        self.shape().initialise(LONGEST_S, rng)
    }
}

/// The model with its parameters, ready to run.
#[derive(Clone, Debug)]
pub(super) struct StateSpace {
    config: StateSpaceConfig,
    network: RecurrentNetwork,
}

impl StateSpace {
    /// A model from its parameters.
    ///
    /// # Panics
    /// If `parameters` does not have [`StateSpaceConfig::parameters`] entries.
    pub fn new(config: StateSpaceConfig, parameters: &[f32]) -> Self {
        Self { config, network: RecurrentNetwork::new(config.shape(), parameters) }
    }
}

impl Dynamics for StateSpace {
    type Tape = RecurrentTape;

    fn tape(&self, blocks: usize) -> RecurrentTape {
        self.network.tape(blocks)
    }

    fn begin(&self, tape: &mut RecurrentTape, start: &BreathStart) {
        let LungParameters { resistance, compliance } = USUAL_LUNG;
        let lung: [Lane; LUNG_INPUTS] = [
            start.resistance.map(|r| (r / resistance).ln()),
            start.compliance.map(|c| (c / compliance).ln()),
        ];
        let RecurrentShape { known, constants, .. } = self.config.shape();
        self.network.begin(tape, &start.known()[..known], &lung[..constants]);
    }

    fn step(&self, tape: &mut RecurrentTape, block: usize, log: &CommandLog, points: &mut [Lane]) {
        self.network.step(tape, block, log, points);
        let (mean, scale) = PRESSURE_SCALE;
        for point in points {
            *point = point.map(|y| mean + scale * y);
        }
    }

    fn step_back(&self, tape: &mut RecurrentTape, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let d_output = |n: usize| d_points[n].map(|d| PRESSURE_SCALE.1 * d);
        self.network.step_back(tape, block, d_output, d_log);
    }

    fn finish(&self, tape: &mut RecurrentTape, gradient: &mut [f32]) {
        self.network.finish(tape, gradient);
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
        let model = StateSpace::new(config, &config.initialise(&mut ChaCha8Rng::seed_from_u64(4)));
        let last_point = |command: f32, block: usize| {
            let (mut tape, mut points) = (model.tape(6), vec![Lane::ZERO; 2]);
            let mut log = CommandLog::new(6, vec![Lane::ZERO; 2]);
            log.block_mut(block).fill(Lane::splat(command));
            model.begin(&mut tape, &BreathStart::default());
            for block in 0..6 {
                model.step(&mut tape, block, &log, &mut points);
            }
            points[1][LANES - 1]
        };
        assert_eq!(last_point(0.0, 5).to_bits(), last_point(1.0, 5).to_bits());
        assert!((last_point(0.0, 4) - last_point(1.0, 4)).abs() > 1e-4);
    }
}
