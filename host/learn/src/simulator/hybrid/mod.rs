//! One simulator for many lungs: a learned ventilator connected to a lung with known nominal R and C.
//!
//! The ventilator sees only commands and outputs two openings; the lung is a physical model with six parameters. The
//! ventilator has no information about the lung and the lung none about the commands, so a lung absent from the
//! recording is just a new pair of numbers. The commands of a closed loop reveal the pressure to a model that sees
//! enough of them; a source that can only drive a lung can hardly exploit this.
//!
//! Deviations of a test run are separate parameters: its actual resistor and compliance, how far its valves opened, and
//! what the physics does not explain. The last is a mixture of a few modes, which a network of leaky states computes
//! from the commands. A breath of an unknown run uses none of them.
//!
//! ```text
//! A, B = ventilator(commands)
//! p'   = lung(A, B)                      airway pressure
//! p    = p' + m tanh(sum of e_k y_k / m)     modes y of the commands, mixed by the test run's e
//! ```

pub(crate) mod lung;
mod own;
pub(crate) mod ventilator;

use std::ops::Range;

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use self::lung::{LungTape, PHYSICS, Physics};
use self::own::Own;
use self::ventilator::{OPENINGS, VentilatorModel, VentilatorTape};
use super::recurrent::{RecurrentNetwork, RecurrentShape, RecurrentTape};
use super::{BreathStart, CommandLog, Dynamics, Members, Timing, piece, piece_mut};
use engine::{LANES, Lane};

/// Number of deviations of a group, as logarithms: R, C, opening towards the supply, opening towards the room. They
/// absorb, for example, a mislabelled resistor; an unseen lung has none.
const DEVIATIONS: usize = lung::DEVIATIONS + OPENINGS;
/// States and hidden units of the network that computes the modes; number of modes of each point.
const REST: (usize, usize) = (16, 32);
const MODES: usize = 8;
/// Initial time constant of the network's slowest state, s.
const LONGEST_REST_S: f32 = 1.0;
/// Largest correction of a test run to the physics, cmH2O: it cannot replace them.
const MOST_REST: f32 = 10.0;

/// Shape of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HybridConfig {
    /// Division of time into blocks.
    pub timing: Timing,
    /// Number of filters in the ventilator.
    pub states: usize,
    /// Number of static curves in the ventilator.
    pub hidden: usize,
    /// Number of past command blocks that a step sees.
    pub history: usize,
    /// Number of ventilators in the recording, each with its own valves.
    #[serde(default)]
    pub ventilators: usize,
    /// Number of groups (test runs) in the recording, each with its own deviations.
    #[serde(default)]
    pub groups: usize,
}

/// Positions of the parts in the parameter vector.
pub(crate) struct HybridLayout {
    pub ventilator: Range<usize>,
    pub physics: Range<usize>,
    deviations: Range<usize>,
    network: Range<usize>,
    mixing: Range<usize>,
}

impl HybridConfig {
    /// The default shape for a control period in microseconds and this number of command channels.
    pub fn for_period(period_us: u32, channels: usize) -> Self {
        let timing = Timing::for_period(period_us, channels);
        Self { timing, states: 8, hidden: 24, history: 8, ventilators: 0, groups: 0 }
    }

    /// Number of modes of a block: each of its points has its own.
    fn modes(&self) -> usize {
        MODES * self.timing.points
    }

    fn network(&self) -> RecurrentShape {
        let (states, hidden) = REST;
        let Self { timing, history, .. } = *self;
        RecurrentShape {
            timing,
            states,
            hidden,
            history,
            known: BreathStart::KNOWN,
            constants: 0,
            outputs: self.modes(),
        }
    }

    pub(crate) fn layout(&self) -> HybridLayout {
        let mut end = 0;
        let mut next = |length: usize| {
            end += length;
            end - length..end
        };
        HybridLayout {
            ventilator: next(self.ventilator_parameters()),
            physics: next(PHYSICS),
            deviations: next(self.groups * DEVIATIONS),
            network: next(self.network().parameters()),
            mixing: next(self.groups * MODES),
        }
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.layout().mixing.end
    }

    /// Parameters of ventilator and lung, including the deviations of ventilators and test runs: all except the modes.
    pub fn physics(&self) -> Range<usize> {
        0..self.layout().deviations.end
    }

    /// Draws initial parameters: a ventilator, a plain lung, and test runs without deviations.
    pub fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let layout = self.layout();
        let mut parameters = vec![0.0; layout.mixing.end];
        parameters[layout.ventilator].copy_from_slice(&self.initialise_ventilator(rng));
        parameters[layout.physics].copy_from_slice(&Physics::PLAIN);
        parameters[layout.network].copy_from_slice(&self.network().initialise(LONGEST_REST_S, rng));
        parameters
    }
}

/// The model with its parameters, ready to run.
#[derive(Clone, Debug)]
pub(super) struct Hybrid {
    config: HybridConfig,
    ventilator: VentilatorModel,
    physics: Physics,
    deviations: Own,
    network: RecurrentNetwork,
    mixing: Own,
}

/// Forward values and backward gradients of a rollout, block by block.
#[derive(Clone, Debug)]
pub(super) struct HybridTape {
    /// Group of each lane.
    group: Members,
    ventilator: VentilatorTape,
    lung: LungTape,
    network: RecurrentTape,
    /// `e` of each lane.
    mixing: [Lane; MODES],
    d_mixing: [Lane; MODES],
    /// `y` of each block.
    modes: Vec<Lane>,
    /// Slope of the bound at each point.
    slopes: Vec<Lane>,
}

impl Hybrid {
    /// A model from its parameters.
    ///
    /// # Panics
    /// If `parameters` does not have [`HybridConfig::parameters`] entries.
    pub fn new(config: HybridConfig, parameters: &[f32]) -> Self {
        let layout = config.layout();
        assert_eq!(parameters.len(), layout.mixing.end, "parameters of another shape");
        Self {
            config,
            ventilator: VentilatorModel::new(config, &parameters[layout.ventilator]),
            physics: Physics::new(&config.timing, &parameters[layout.physics]),
            deviations: Own::new(DEVIATIONS, &parameters[layout.deviations]),
            network: RecurrentNetwork::new(config.network(), &parameters[layout.network]),
            mixing: Own::new(MODES, &parameters[layout.mixing]),
        }
    }
}

impl Dynamics for Hybrid {
    type Tape = HybridTape;

    fn tape(&self, blocks: usize) -> HybridTape {
        let steps = blocks * self.config.timing.points;
        HybridTape {
            group: [None; LANES],
            ventilator: self.ventilator.tape(blocks),
            lung: Physics::tape(steps),
            network: self.network.tape(blocks),
            mixing: [Lane::ZERO; MODES],
            d_mixing: [Lane::ZERO; MODES],
            modes: vec![Lane::ZERO; steps * MODES],
            slopes: vec![Lane::ZERO; steps],
        }
    }

    fn begin(&self, tape: &mut HybridTape, start: &BreathStart) {
        tape.group = start.group;
        let [resistance, compliance, inlet, outlet] =
            std::array::from_fn(|n| self.deviations.lane(&start.group, n));
        self.ventilator.begin(&mut tape.ventilator, start, &[inlet, outlet]);
        self.physics.begin(&mut tape.lung, start, &[resistance, compliance]);
        self.network.begin(&mut tape.network, &start.known(), &[]);
        tape.mixing = std::array::from_fn(|n| self.mixing.lane(&start.group, n));
        tape.d_mixing.fill(Lane::ZERO);
    }

    fn step(&self, tape: &mut HybridTape, block: usize, log: &CommandLog, points: &mut [Lane]) {
        self.ventilator.step(&mut tape.ventilator, block, log);
        let modes = piece_mut(&mut tape.modes, block, self.config.modes());
        self.network.step(&mut tape.network, block, log, modes);
        let first = block * points.len();
        for (n, (point, modes)) in points.iter_mut().zip(modes.chunks_exact(MODES)).enumerate() {
            *point = tape.lung.step(first + n, &tape.ventilator.openings[block]);
            let mut rest = Lane::ZERO;
            for (e, y) in tape.mixing.iter().zip(modes) {
                rest.add_scaled(1.0, &e.zip(y, |e, y| e * y));
            }
            let bounded = rest.map(|rest| (rest / MOST_REST).tanh());
            point.add_scaled(MOST_REST, &bounded);
            tape.slopes[first + n] = bounded.map(|b| 1.0 - b * b);
        }
    }

    fn step_back(&self, tape: &mut HybridTape, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let first = block * d_points.len();
        let mut d_openings = [Lane::ZERO; OPENINGS];
        for (n, d_point) in d_points.iter().enumerate().rev() {
            tape.lung.step_back(first + n, &tape.ventilator.openings[block], d_point, &mut d_openings);
        }
        self.ventilator.step_back(&mut tape.ventilator, block, &d_openings, d_log);

        let d_rest = |n: usize| d_points[n].zip(&tape.slopes[first + n], |d, slope| d * slope);
        let modes = piece(&tape.modes, block, self.config.modes());
        for (n, modes) in modes.chunks_exact(MODES).enumerate() {
            for (d_e, y) in tape.d_mixing.iter_mut().zip(modes) {
                d_e.add_scaled(1.0, &d_rest(n).zip(y, |d, y| d * y));
            }
        }
        let d_mode = |n: usize| d_rest(n / MODES).zip(&tape.mixing[n % MODES], |d, e| d * e);
        self.network.step_back(&mut tape.network, block, d_mode, d_log);
    }

    fn finish(&self, tape: &mut HybridTape, gradient: &mut [f32]) {
        let layout = self.config.layout();
        self.ventilator.finish(&tape.ventilator, &mut gradient[layout.ventilator]);
        let [resistance, compliance] = Physics::finish(&tape.lung, &mut gradient[layout.physics]);
        let [inlet, outlet] = tape.ventilator.d_stretch;
        for (n, d) in [resistance, compliance, inlet, outlet].iter().enumerate() {
            self.deviations.add_gradient(&tape.group, n, d, &mut gradient[layout.deviations.clone()]);
        }
        self.network.finish(&tape.network, &mut gradient[layout.network]);
        for (n, d) in tape.d_mixing.iter().enumerate() {
            self.mixing.add_gradient(&tape.group, n, d, &mut gradient[layout.mixing.clone()]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::model::Architecture;
    use crate::simulator::tests_support::{check_gradients, check_gradients_by};
    use rand_chacha::rand_core::SeedableRng;

    fn config(period_us: u32) -> HybridConfig {
        HybridConfig {
            states: 5,
            hidden: 7,
            history: 3,
            ventilators: 2,
            groups: 2,
            ..HybridConfig::for_period(period_us, 1)
        }
    }

    /// Parameters with physics off their initial values, and with deviations of test runs and ventilators.
    fn varied(config: &HybridConfig, seed: u64) -> Vec<f32> {
        let layout = config.layout();
        let mut parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(seed));
        parameters[layout.physics].copy_from_slice(&[1.8, 2.8, 0.2, 0.9, 0.3, 3.7]);
        let own =
            layout.ventilator.end - config.ventilators * (config.hidden + OPENINGS)..layout.ventilator.end;
        for range in [own, layout.deviations, layout.mixing] {
            for (n, parameter) in parameters[range].iter_mut().enumerate() {
                *parameter = 0.1 * (n as f32).sin();
            }
        }
        parameters
    }

    #[test]
    fn gradients_of_a_rollout_agree_with_finite_differences() {
        for period_us in [1000, 30_000] {
            let config = config(period_us);
            let architecture = Architecture::Hybrid(config);
            check_gradients(architecture, &config.initialise(&mut ChaCha8Rng::seed_from_u64(3)));
            check_gradients(architecture, &varied(&config, 3));
        }
    }

    #[test]
    fn what_physics_runs_and_ventilators_have_has_the_gradients_of_finite_differences() {
        let config = HybridConfig {
            states: 1,
            hidden: 1,
            history: 1,
            ventilators: 2,
            groups: 3,
            ..HybridConfig::for_period(30_000, 1)
        };
        let (parameters, layout) = (varied(&config, 5), config.layout());
        // The network has its own gradient check in `state_space`.
        let all_but_network = (0..layout.network.start).chain(layout.mixing);
        check_gradients_by(all_but_network, Architecture::Hybrid(config), &parameters);
    }

    /// Pressure and volume (mL) in each lane after a long inflation with a constant command.
    fn blown(resistance: Lane, compliance: Lane, blocks: usize) -> (Lane, Lane) {
        let config = config(10_000);
        let model = Hybrid::new(config, &config.initialise(&mut ChaCha8Rng::seed_from_u64(4)));
        let (mut tape, mut points) = (model.tape(blocks), vec![Lane::ZERO; 1]);
        let log = CommandLog::new(blocks, vec![Lane::splat(1.0); 1]);
        let pressure = Lane::splat(5.0);
        model.begin(
            &mut tape,
            &BreathStart { pressure, plateau: pressure, resistance, compliance, ..BreathStart::default() },
        );
        for block in 0..blocks {
            model.step(&mut tape, block, &log, &mut points);
        }
        (points[0], tape.lung.alveolar.zip(&compliance, |a, c| (a - 5.0) * c))
    }

    /// Pressures of a rollout with these parameters.
    fn pressures(config: HybridConfig, parameters: &[f32], start: &BreathStart) -> Vec<Lane> {
        const BLOCKS: usize = 12;
        let model = Hybrid::new(config, parameters);
        let mut tape = model.tape(BLOCKS);
        let log = CommandLog::new(BLOCKS, vec![Lane::splat(1.0); config.timing.width()]);
        model.begin(&mut tape, start);
        let mut points = vec![Lane::ZERO; config.timing.points];
        (0..BLOCKS)
            .flat_map(|block| {
                model.step(&mut tape, block, &log, &mut points);
                points.clone()
            })
            .collect()
    }

    #[test]
    fn a_run_that_nobody_knows_has_nothing_of_the_others_and_a_known_one_a_bounded_rest() {
        let config = config(10_000);
        let (own, layout) = (varied(&config, 6), config.layout());
        let mut common = own.clone();
        common[layout.deviations].fill(0.0);
        common[layout.mixing.clone()].fill(0.0);
        let mut wild = common.clone();
        wild[layout.mixing].fill(1e4);
        let unknown = BreathStart { ventilator: [Some(1); LANES], ..BreathStart::default() };
        let known = BreathStart { group: [Some(1); LANES], ..unknown };
        let physics = pressures(config, &common, &unknown);
        assert_eq!(pressures(config, &own, &unknown), physics);
        assert_ne!(pressures(config, &own, &known), physics);
        let rest = pressures(config, &wild, &known)
            .iter()
            .zip(&physics)
            .map(|(p, q)| (p[0] - q[0]).abs())
            .fold(0.0, f32::max);
        assert!(rest > 0.9 * MOST_REST && rest < 1.001 * MOST_REST, "{rest}");
    }

    #[test]
    fn a_stiff_or_narrow_lung_is_at_a_higher_pressure_with_less_in_it() {
        let sizes = Lane::from_fn(|l| 5.0 + 3.0 * l as f32);
        let (pressure, volume) = blown(Lane::splat(20.0), sizes, 20);
        for l in 1..LANES {
            assert!(pressure[l] < pressure[l - 1] && volume[l] > volume[l - 1], "compliance, lane {l}");
        }
        let (pressure, volume) = blown(sizes, Lane::splat(20.0), 20);
        for l in 1..LANES {
            assert!(pressure[l] > pressure[l - 1] && volume[l] < volume[l - 1], "resistance, lane {l}");
        }
    }
}
