//! One rollout of a simulator over a shard: commands in, pressures out, and the gradients backward.
//!
//! It runs either in closed loop, where each command is chosen from the pressure before it ([`Rollout::begin`],
//! [`Rollout::pressure`], [`Rollout::advance`]; backward: [`Rollout::start_back`], [`Rollout::command_gradient`],
//! [`Rollout::add_pressure_gradient`]), or over the commands of a recording ([`Rollout::replay`],
//! [`Rollout::replay_back`]). No state of a breath is carried into the next one, so the memory of a rollout can be
//! reused.

use super::design::Dynamics;
use super::model::Model;
use super::shard::Shard;
use super::{BreathStart, COMMAND_SCALE, CommandLog, Timing, piece, piece_mut};
use engine::Lane;

/// A simulator running on one shard, with the memory for breaths of a given length.
#[derive(Debug)]
pub struct Rollout {
    model: Model,
    dynamics: Box<dyn Dynamics>,
    timing: Timing,
    ticks: usize,
    log: CommandLog,
    d_log: CommandLog,
    /// Pressure at the start of the breath, then at the points of each block, cmH2O.
    points: Vec<Lane>,
    d_points: Vec<Lane>,
    tick: usize,
}

impl Rollout {
    /// Memory for breaths of at most `ticks` ticks on a model.
    pub fn new(model: &Model, ticks: usize) -> Self {
        let timing = *model.architecture().timing();
        let blocks = timing.blocks(ticks);
        let log = CommandLog::new(blocks, vec![Lane::ZERO; timing.width()]);
        let points = vec![Lane::ZERO; 1 + blocks * timing.points];
        Self {
            model: model.clone(),
            dynamics: model.dynamics(blocks),
            timing,
            ticks,
            d_log: log.clone(),
            log,
            d_points: points.clone(),
            points,
            tick: 0,
        }
    }

    /// Starts a breath of a model from these commands at rest, percent, at tick 0.
    pub fn begin(&mut self, model: &Model, start: &BreathStart, rest: &Lane) {
        if self.model.architecture() != model.architecture() {
            *self = Self::new(model, self.ticks);
        } else if !self.model.is(model) {
            self.dynamics.load(model.parameters());
            self.model = model.clone();
        }
        self.log.reset(rest.map(|rest| rest / COMMAND_SCALE));
        self.start_breath(start);
        if self.timing.lag() > 0 {
            self.predict(0);
        }
    }

    /// Simulated pressure at the present tick, cmH2O.
    pub fn pressure(&self) -> Lane {
        self.pressure_at(self.tick)
    }

    /// Simulated pressure at a tick up to the present one, cmH2O: interpolated between the points around it.
    pub fn pressure_at(&self, tick: usize) -> Lane {
        let (first, weights) = self.around(tick);
        let mut pressure = Lane::ZERO;
        for (point, weight) in self.points[first..].iter().zip(&weights[..=self.timing.points]) {
            pressure.add_scaled(*weight, point);
        }
        pressure
    }

    /// Applies a command in percent for the present tick and advances to the next one.
    pub fn advance(&mut self, command: &Lane) {
        let (block, place, share) = self.entry(self.tick);
        self.log.block_mut(block)[place].add_scaled(share, command);
        self.tick += 1;
        if self.tick.is_multiple_of(self.timing.block_ticks) {
            self.predict(block + self.timing.lag());
        }
    }

    /// Starts the backward pass through a breath. Ticks follow from last to first: for each, call
    /// [`Self::command_gradient`], then [`Self::add_pressure_gradient`].
    pub fn start_back(&mut self) {
        self.d_log.reset(Lane::ZERO);
        self.d_points.fill(Lane::ZERO);
    }

    /// Gradient with respect to the command of a tick, percent, from those of the pressures of all later ticks.
    pub fn command_gradient(&mut self, tick: usize) -> Lane {
        let (block, place, share) = self.entry(tick);
        if (tick + 1).is_multiple_of(self.timing.block_ticks) {
            self.predict_back(block + self.timing.lag());
        }
        self.d_log.block(Some(block))[place].map(|d| share * d)
    }

    /// Adds the gradient with respect to the pressure at a tick.
    pub fn add_pressure_gradient(&mut self, tick: usize, d_pressure: &Lane) {
        let (first, weights) = self.around(tick);
        for (d, weight) in self.d_points[first..].iter_mut().zip(&weights[..=self.timing.points]) {
            d.add_scaled(*weight, d_pressure);
        }
    }

    /// Runs the breaths of a shard with the recorded commands. With `teacher_forcing`, architectures trained this way
    /// start every block from a measured pressure.
    pub fn replay(model: &Model, shard: &Shard<'_>, teacher_forcing: bool) -> Self {
        let mut rollout = Self::new(model, shard.ticks());
        let timing = rollout.timing;
        rollout.log = shard.log(&timing);
        rollout.start_breath(&shard.start());
        for block in 0..timing.blocks(rollout.ticks) {
            rollout.predict(block);
            if teacher_forcing {
                rollout.dynamics.teach(block, &shard.pressure((block + 1) * timing.block_ticks));
            }
        }
        rollout
    }

    /// Backward pass of [`Self::replay`], after [`Self::add_pressure_gradient`] for all ticks: adds the gradient with
    /// respect to the model's parameters.
    pub fn replay_back(&mut self, gradient: &mut [f32]) {
        for block in (0..self.timing.blocks(self.ticks)).rev() {
            self.predict_back(block);
        }
        self.dynamics.finish(gradient);
    }

    fn start_breath(&mut self, start: &BreathStart) {
        self.points[0] = start.pressure;
        self.tick = 0;
        self.dynamics.begin(start);
    }

    /// Runs the model's step of a block; no effect after the end of the breath.
    fn predict(&mut self, block: usize) {
        if block < self.timing.blocks(self.ticks) {
            let points = piece_mut(&mut self.points[1..], block, self.timing.points);
            self.dynamics.step(block, &self.log, points);
        }
    }

    /// Backward pass of [`Self::predict`].
    fn predict_back(&mut self, block: usize) {
        if block < self.timing.blocks(self.ticks) {
            let d_points = piece(&self.d_points[1..], block, self.timing.points);
            self.dynamics.step_back(block, d_points, &mut self.d_log);
        }
    }

    /// Index of the first point around a tick, and the weights of this point and the next ones.
    fn around(&self, tick: usize) -> (usize, [f32; 3]) {
        let Timing { block_ticks, points, .. } = self.timing;
        (tick / block_ticks * points, self.timing.interpolation(tick % block_ticks))
    }

    /// Position of a tick's command in the log: block, place, and weight of one percent.
    fn entry(&self, tick: usize) -> (usize, usize, f32) {
        let place = self.timing.part(tick % self.timing.block_ticks);
        let share = 1.0 / (COMMAND_SCALE * self.timing.part_ticks(place) as f32);
        (tick / self.timing.block_ticks, place, share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::episode::Episode;
    use crate::simulator::hybrid::HybridConfig;
    use crate::simulator::model::Architecture;
    use crate::simulator::state_space::StateSpaceConfig;
    use crate::simulator::stitched::StitchedConfig;
    use crate::simulator::tests_support::episode;
    use crate::tests_support::check_slopes;
    use engine::LANES;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    const REST: f32 = 5.0;

    fn model(architecture: Architecture) -> Model {
        Model::new(architecture, &architecture.initialise(&mut ChaCha8Rng::seed_from_u64(8)))
    }

    fn state_space(states: usize) -> Architecture {
        Architecture::StateSpace(StateSpaceConfig { states, ..StateSpaceConfig::for_period(1000, 1) })
    }

    fn all() -> [(Model, usize); 3] {
        let hybrid = Architecture::Hybrid(HybridConfig::for_period(1000, 1));
        let stitched = Architecture::Stitched(StitchedConfig::for_period(30_000));
        // As initialised, the authors' networks are so steep that rounding errors grow from tick to tick.
        let wild = stitched.initialise(&mut ChaCha8Rng::seed_from_u64(8));
        let tame: Vec<f32> = wild.iter().map(|w| 0.5 * w).collect();
        [(model(state_space(16)), 123), (model(hybrid), 123), (Model::new(stitched, &tame), 33)]
    }

    fn start() -> BreathStart {
        BreathStart {
            pressure: Lane::from_fn(|l| 5.0 + 0.1 * l as f32),
            plateau: Lane::splat(20.0),
            rest: Lane::splat(REST / COMMAND_SCALE),
            plateau_command: Lane::splat(1.0),
            ..BreathStart::default()
        }
    }

    fn command(tick: usize) -> Lane {
        Lane::from_fn(|l| 40.0 + l as f32 + 10.0 * (0.1 * tick as f32).sin())
    }

    /// Pressures of a breath, tick by tick.
    fn breath(rollout: &mut Rollout, model: &Model, ticks: usize) -> Vec<Lane> {
        rollout.begin(model, &start(), &Lane::splat(REST));
        let step = |tick: usize| {
            let pressure = rollout.pressure();
            rollout.advance(&command(tick));
            pressure
        };
        (0..ticks).map(step).collect()
    }

    /// The same breath as a recording: one episode per lane, with commands averaged over parts.
    fn recorded(timing: &Timing, ticks: usize, l: usize) -> Episode {
        let mut commands = vec![0.0; timing.blocks(ticks) * timing.parts];
        for tick in 0..ticks {
            let part = timing.part(tick % timing.block_ticks);
            commands[tick / timing.block_ticks * timing.parts + part] +=
                command(tick)[l] / (COMMAND_SCALE * timing.part_ticks(part) as f32);
        }
        let start = start();
        Episode {
            commands,
            rest: vec![REST / COMMAND_SCALE; timing.parts],
            start: start.pressure[l],
            plateau: start.plateau[l],
            plateau_command: start.plateau_command[l],
            ..episode(ticks)
        }
    }

    #[test]
    fn ticks_give_the_pressures_of_the_replay_whatever_ran_before() {
        for (model, ticks) in all() {
            let mut rollout = Rollout::new(&self::model(state_space(3)), ticks);
            let first = breath(&mut rollout, &model, ticks);
            assert_ne!(first[0], first[ticks - 1]);
            assert_eq!(breath(&mut rollout, &model, ticks), first, "nothing is left of the last breath");

            let timing = *model.architecture().timing();
            let episodes: Vec<Episode> = (0..LANES).map(|l| recorded(&timing, ticks, l)).collect();
            let replay = Rollout::replay(&model, &Shard::cut(&episodes.iter().collect::<Vec<_>>())[0], false);
            for (tick, pressure) in first.iter().enumerate() {
                for l in 0..LANES {
                    let difference = (replay.pressure_at(tick)[l] - pressure[l]).abs();
                    assert!(difference < 1e-3, "{:?}, tick {tick}: {difference}", model.architecture());
                }
            }
        }
    }

    fn weight(tick: usize) -> f32 {
        20.0 + 10.0 * (0.7 * tick as f32).cos()
    }

    /// Sum of the pressures of all ticks under these commands, with different weights.
    fn weighted(rollout: &mut Rollout, model: &Model, commands: &[f32]) -> f64 {
        rollout.begin(model, &start(), &Lane::splat(REST));
        let mut total = 0.0;
        for (tick, command) in commands.iter().enumerate() {
            total += f64::from(weight(tick) * rollout.pressure()[3]);
            rollout.advance(&Lane::splat(*command));
        }
        total
    }

    #[test]
    fn gradients_by_commands_agree_with_finite_differences() {
        for (model, ticks) in all() {
            let commands: Vec<f32> = (0..ticks).map(|tick| command(tick)[3]).collect();
            let mut rollout = Rollout::new(&model, ticks);
            weighted(&mut rollout, &model, &commands);
            rollout.start_back();
            let mut gradient = vec![0.0; ticks];
            for tick in (0..ticks).rev() {
                gradient[tick] = rollout.command_gradient(tick)[3];
                rollout.add_pressure_gradient(tick, &Lane::splat(weight(tick)));
            }
            check_slopes("command", &commands, 0.2, &gradient, |varied| {
                weighted(&mut Rollout::new(&model, ticks), &model, varied)
            });
        }
    }
}
