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

mod graph;
mod lung;
mod own;
mod ventilator;

use std::ops::Range;

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use self::lung::{LungEquations, LungTrajectory, PHYSICS};
use self::own::Own;
use self::ventilator::{OPENINGS, VentilatorModel, VentilatorTape};
use super::block::Block;
use super::design::{Design, Dynamics};
use super::episode::{Episode, whole_breaths};
use super::fit_config::{BATCH, FitConfig};
use super::recurrent::{RecurrentNetwork, RecurrentShape, RecurrentTape};
use super::shape::{ShapeError, members, widths};
use super::trajectory::Trajectory;
use super::{BreathStart, CommandLog, Members, Timing, piece, piece_mut};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use data::recording::Recording;
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
/// Weight decay: of 0.005, 0.02 and 0.05 it was best on lungs held out one by one.
const DECAY: f32 = 0.005;
/// Number of gradient steps after which a fit gains little: a fifth for the physics, the rest for the deviations of each test run.
const STEPS: usize = 15_000;
/// Share of the epochs after which a fit freezes the physics and trains only the deviations. With a larger share, held-out
/// measured lungs scored worse (docs/RECORDINGS.md).
const SETTLED: f32 = 0.2;

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
pub(super) struct HybridLayout {
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

    pub(super) fn layout(&self) -> HybridLayout {
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

    /// Parameters of ventilator and lung, including the deviations of ventilators and test runs: all except the modes.
    pub(super) fn physics(&self) -> Range<usize> {
        0..self.layout().deviations.end
    }
}

impl Design for HybridConfig {
    fn timing(&self) -> &Timing {
        &self.timing
    }

    fn parameters(&self) -> usize {
        self.layout().mixing.end
    }

    fn members(&self) -> usize {
        self.ventilators
    }

    fn many_lungs(&self) -> bool {
        true
    }

    fn check(&self) -> Result<(), ShapeError> {
        self.timing.check()?;
        widths(self.states, self.hidden, self.history)?;
        // Without ventilators and test runs of its own it is one of an unknown ventilator.
        members("ventilators", self.ventilators, 0)?;
        members("groups", self.groups, 0)
    }

    fn fitting(&self) -> (FitConfig, Option<usize>) {
        let mut config = FitConfig { batch: BATCH, ..FitConfig::default() };
        config.adam.weight_decay = DECAY;
        (config, Some(STEPS))
    }

    fn groups(&self) -> Vec<(Range<usize>, f32)> {
        let physics = self.physics();
        vec![(physics.clone(), SETTLED), (physics.end..self.parameters(), 1.0)]
    }

    /// Whole breaths, because expirations too contain information about lung and ventilator. Each is there twice, once
    /// without its group, so that the parameters of a group remain deviations from a model that is correct without them.
    fn lessons(&self, recording: &Recording, training: &[&Episode]) -> Vec<Episode> {
        let mut lessons = whole_breaths(recording, &self.timing);
        lessons.retain(|breath| training.iter().any(|episode| episode.rows == breath.rows));
        let nameless: Vec<_> =
            lessons.iter().map(|breath| Episode { group: None, ..breath.clone() }).collect();
        lessons.extend(nameless);
        lessons
    }

    fn dynamics(&self, parameters: &[f32], blocks: usize) -> Box<dyn Dynamics> {
        Box::new(Hybrid::new(*self, parameters, blocks))
    }

    fn graph(&self, graph: &mut Builder, block: &Block, parameters: &[f32]) -> (Value, State) {
        graph::hybrid(graph, block, self, parameters)
    }

    /// A ventilator, a plain lung, and test runs without deviations.
    fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let layout = self.layout();
        let mut parameters = vec![0.0; layout.mixing.end];
        parameters[layout.ventilator].copy_from_slice(&self.initialise_ventilator(rng));
        parameters[layout.physics].copy_from_slice(&lung::PLAIN);
        parameters[layout.network].copy_from_slice(&self.network().initialise(LONGEST_REST_S, rng));
        parameters
    }
}

/// The model with its parameters and the memory of a rollout.
#[derive(Debug)]
struct Hybrid {
    model: HybridModel,
    tape: HybridTape,
}

/// The model with its parameters.
#[derive(Debug)]
struct HybridModel {
    config: HybridConfig,
    ventilator: VentilatorModel,
    physics: [f32; PHYSICS],
    deviations: Own,
    network: RecurrentNetwork,
    mixing: Own,
}

/// Forward values and backward gradients of a rollout, block by block.
#[derive(Debug)]
struct HybridTape {
    /// Group of each lane.
    group: Members,
    ventilator: VentilatorTape,
    lung: LungTrajectory,
    network: RecurrentTape,
    /// `e` of each lane.
    mixing: [Lane; MODES],
    d_mixing: [Lane; MODES],
    /// `y` of each block.
    modes: Vec<Lane>,
    /// Slope of the bound at each point.
    slopes: Vec<Lane>,
}

impl HybridModel {
    fn new(config: HybridConfig, parameters: &[f32]) -> Self {
        let layout = config.layout();
        Self {
            config,
            ventilator: VentilatorModel::new(config, &parameters[layout.ventilator]),
            physics: std::array::from_fn(|n| parameters[layout.physics.start + n]),
            deviations: Own::new(DEVIATIONS, &parameters[layout.deviations]),
            network: RecurrentNetwork::new(config.network(), &parameters[layout.network]),
            mixing: Own::new(MODES, &parameters[layout.mixing]),
        }
    }
}

impl Hybrid {
    fn new(config: HybridConfig, parameters: &[f32], blocks: usize) -> Self {
        let model = HybridModel::new(config, parameters);
        let steps = blocks * config.timing.points;
        let tape = HybridTape {
            group: [None; LANES],
            ventilator: model.ventilator.tape(blocks),
            lung: Trajectory::new(LungEquations::new(&config.timing), steps),
            network: model.network.tape(blocks),
            mixing: [Lane::ZERO; MODES],
            d_mixing: [Lane::ZERO; MODES],
            modes: vec![Lane::ZERO; steps * MODES],
            slopes: vec![Lane::ZERO; steps],
        };
        Self { model, tape }
    }
}

impl Dynamics for Hybrid {
    fn load(&mut self, parameters: &[f32]) {
        self.model = HybridModel::new(self.model.config, parameters);
    }

    fn begin(&mut self, start: &BreathStart) {
        let Self { model, tape } = self;
        tape.group = start.group;
        let [resistance, compliance, inlet, outlet] =
            std::array::from_fn(|n| model.deviations.lane(&start.group, n));
        model.ventilator.begin(&mut tape.ventilator, start, &[inlet, outlet]);
        tape.lung.begin(&lung::given(&model.physics, start, &[resistance, compliance]));
        model.network.begin(&mut tape.network, &start.known(), &[]);
        tape.mixing = std::array::from_fn(|n| model.mixing.lane(&start.group, n));
        tape.d_mixing.fill(Lane::ZERO);
    }

    fn step(&mut self, block: usize, log: &CommandLog, points: &mut [Lane]) {
        let Self { model, tape } = self;
        model.ventilator.step(&mut tape.ventilator, block, log);
        let modes = piece_mut(&mut tape.modes, block, model.config.modes());
        model.network.step(&mut tape.network, block, log, modes);
        let first = block * points.len();
        for (n, (point, modes)) in points.iter_mut().zip(modes.chunks_exact(MODES)).enumerate() {
            [*point, _] = *tape.lung.step(first + n, &tape.ventilator.openings[block]);
            let mut rest = Lane::ZERO;
            for (e, y) in tape.mixing.iter().zip(modes) {
                rest.add_scaled(1.0, &e.zip(y, |e, y| e * y));
            }
            let bounded = rest.map(|rest| (rest / MOST_REST).tanh());
            point.add_scaled(MOST_REST, &bounded);
            tape.slopes[first + n] = bounded.map(|b| 1.0 - b * b);
        }
    }

    fn step_back(&mut self, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let Self { model, tape } = self;
        let first = block * d_points.len();
        let mut d_openings = [Lane::ZERO; OPENINGS];
        for (n, d_point) in d_points.iter().enumerate().rev() {
            let d_inputs = tape.lung.step_back(first + n, 0, d_point);
            d_openings = std::array::from_fn(|n| d_openings[n] + d_inputs[n]);
        }
        model.ventilator.step_back(&mut tape.ventilator, block, &d_openings, d_log);

        let d_rest = |n: usize| d_points[n].zip(&tape.slopes[first + n], |d, slope| d * slope);
        let modes = piece(&tape.modes, block, model.config.modes());
        for (n, modes) in modes.chunks_exact(MODES).enumerate() {
            for (d_e, y) in tape.d_mixing.iter_mut().zip(modes) {
                d_e.add_scaled(1.0, &d_rest(n).zip(y, |d, y| d * y));
            }
        }
        let d_mode = |n: usize| d_rest(n / MODES).zip(&tape.mixing[n % MODES], |d, e| d * e);
        model.network.step_back(&mut tape.network, block, d_mode, d_log);
    }

    fn finish(&self, gradient: &mut [f32]) {
        let Self { model, tape } = self;
        let layout = model.config.layout();
        model.ventilator.finish(&tape.ventilator, &mut gradient[layout.ventilator]);
        let [resistance, compliance] = lung::finish(&tape.lung, &mut gradient[layout.physics]);
        let [inlet, outlet] = tape.ventilator.d_stretch;
        for (n, d) in [resistance, compliance, inlet, outlet].iter().enumerate() {
            model.deviations.add_gradient(&tape.group, n, d, &mut gradient[layout.deviations.clone()]);
        }
        model.network.finish(&tape.network, &mut gradient[layout.network]);
        for (n, d) in tape.d_mixing.iter().enumerate() {
            model.mixing.add_gradient(&tape.group, n, d, &mut gradient[layout.mixing.clone()]);
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
        let parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(4));
        let (mut model, mut points) = (Hybrid::new(config, &parameters, blocks), vec![Lane::ZERO; 1]);
        let log = CommandLog::new(blocks, vec![Lane::splat(1.0); 1]);
        let pressure = Lane::splat(5.0);
        model.begin(&BreathStart {
            pressure,
            plateau: pressure,
            resistance,
            compliance,
            ..BreathStart::default()
        });
        for block in 0..blocks {
            model.step(block, &log, &mut points);
        }
        (points[0], model.tape.lung.state[1].zip(&compliance, |a, c| (a - 5.0) * c))
    }

    /// Pressures of a rollout with these parameters.
    fn pressures(config: HybridConfig, parameters: &[f32], start: &BreathStart) -> Vec<Lane> {
        const BLOCKS: usize = 12;
        let mut model = config.dynamics(parameters, BLOCKS);
        let log = CommandLog::new(BLOCKS, vec![Lane::splat(1.0); config.timing.width()]);
        model.begin(start);
        let mut points = vec![Lane::ZERO; config.timing.points];
        (0..BLOCKS)
            .flat_map(|block| {
                model.step(block, &log, &mut points);
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
