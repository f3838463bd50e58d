//! A learned simulator advanced one control tick at a time, for learners that must see each pressure before they
//! choose the next command.
//!
//! The rollouts of [`learn::controller::rollout`] do the same in one go, with a controller inside; a test holds both to
//! the same pressures, bit for bit.

use engine::Lane;
use learn::simulator::model::{Model, Simulator};
use learn::simulator::{COMMAND_SCALE, CommandLog, Dynamics, Start};

/// The lungs of a shard, during an inspiration.
pub trait SimulatedLung: Send {
    /// Starts an inspiration from a command of `rest` percent; the tick is 0.
    fn begin(&mut self, start: &Start, rest: f32);

    /// Simulated pressure at the present tick, cmH2O.
    fn pressure(&self) -> Lane;

    /// Applies a command in percent for the present tick and goes on to the next one.
    fn advance(&mut self, command: &Lane);
}

/// A simulator's lungs for inspirations of at most so many ticks.
pub fn simulated_lung(simulator: &Simulator, ticks: usize) -> Box<dyn SimulatedLung> {
    match simulator.model() {
        Model::StateSpace(model) => Box::new(Stepped::new(model, ticks)),
        Model::Hybrid(model) => Box::new(Stepped::new(model, ticks)),
        Model::Stitched(model) => Box::new(Stepped::new(model, ticks)),
    }
}

struct Stepped<M: Dynamics> {
    tape: M::Tape,
    model: M,
    blocks: usize,
    log: CommandLog,
    /// Pressure at the start and at the points of each block, cmH2O.
    points: Vec<Lane>,
    tick: usize,
}

impl<M: Dynamics> Stepped<M> {
    fn new(model: M, ticks: usize) -> Self {
        let timing = model.timing();
        let blocks = timing.blocks(ticks);
        let log = CommandLog::new(blocks, vec![Lane::ZERO; timing.width()]);
        let points = vec![Lane::ZERO; 1 + blocks * timing.points];
        Self { tape: model.tape(blocks), model, blocks, log, points, tick: 0 }
    }

    fn predict(&mut self, block: usize) {
        let count = self.model.timing().points;
        if block < self.blocks {
            let points = &mut self.points[1 + block * count..][..count];
            self.model.step(&mut self.tape, block, &self.log, points);
        }
    }
}

impl<M: Dynamics + Send> SimulatedLung for Stepped<M> {
    fn begin(&mut self, start: &Start, rest: f32) {
        let timing = *self.model.timing();
        self.log = CommandLog::new(self.blocks, vec![Lane::splat(rest / COMMAND_SCALE); timing.width()]);
        self.points[0] = start.pressure;
        self.tick = 0;
        self.model.begin(&mut self.tape, start);
        if timing.lag() > 0 {
            self.predict(0);
        }
    }

    fn pressure(&self) -> Lane {
        let timing = self.model.timing();
        let around = &self.points[self.tick / timing.block_ticks * timing.points..];
        let weights = timing.interpolation(self.tick % timing.block_ticks);
        let mut pressure = Lane::ZERO;
        for (point, weight) in around.iter().zip(weights).take(1 + timing.points) {
            pressure.add_scaled(weight, point);
        }
        pressure
    }

    fn advance(&mut self, command: &Lane) {
        let timing = *self.model.timing();
        let (block, within) = (self.tick / timing.block_ticks, self.tick % timing.block_ticks);
        let part = timing.part(within);
        let share = 1.0 / (COMMAND_SCALE * timing.part_ticks(part) as f32);
        self.log.block_mut(block)[part].add_scaled(share, command);
        self.tick += 1;
        if self.tick.is_multiple_of(timing.block_ticks) {
            self.predict(block + timing.lag());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::LANES;
    use learn::controller::network::{chip_network, initial_parameters};
    use learn::controller::rollout::{LaneController, Scenario};
    use learn::simulator::hybrid::HybridConfig;
    use learn::simulator::model::Architecture;
    use learn::simulator::state_space::StateSpaceConfig;
    use learn::simulator::stitched::StitchedConfig;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use shared::control::features::FeatureSpec;
    use shared::control::pid::PidGains;
    use shared::control::residual::{Residual, ResidualSpec};

    fn simulator(architecture: Architecture) -> Simulator {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let parameters = match &architecture {
            Architecture::StateSpace(config) => config.initialise(&mut rng),
            Architecture::Hybrid(config) => config.initialise(&mut rng),
            Architecture::Stitched(config) => config.initialise(&mut rng),
        };
        Simulator { architecture, parameters, noise: 0.1, start_pressure: 5.0, plant: String::new() }
    }

    /// Pressures and commands of a whole rollout under a controller.
    fn rollout(
        model: &impl Dynamics,
        scenario: &Scenario,
        controller: &LaneController<'_>,
    ) -> (Vec<Lane>, Vec<Lane>) {
        let mut tape = controller.tape(model, scenario.ticks);
        controller.forward(model, scenario, &mut tape);
        (tape.pressure().to_vec(), tape.command().to_vec())
    }

    #[test]
    fn ticks_give_the_pressures_of_the_whole_rollout() {
        let ours = (Architecture::StateSpace(StateSpaceConfig::for_period(1000, 1)), 1000, 123);
        let authors = (Architecture::Stitched(StitchedConfig::for_period(30_000)), 30_000, 33);
        let many = (Architecture::Hybrid(HybridConfig::for_period(1000, 1)), 1000, 123);
        for (architecture, period_us, ticks) in [ours, many, authors] {
            let parameters = initial_parameters(&mut ChaCha8Rng::seed_from_u64(2));
            let spec = ResidualSpec {
                period_us,
                gains: PidGains { p: 2.0, i: 20.0, d: 0.0 },
                lambda: 1.0,
                authority: 100.0,
                features: FeatureSpec::for_period(period_us),
            };
            let base = Residual::new(spec, chip_network(&parameters)).unwrap();
            let controller = LaneController::new(&base, &parameters);
            let pip = Lane::from_fn(|l| 10.0 + l as f32);
            let scenario = Scenario {
                ticks,
                pip,
                peep: 5.0,
                start: Start { pressure: Lane::splat(5.1), plateau: pip, ..Start::default() },
                rest: 5.0,
                noise: vec![Lane::splat(0.1); ticks],
                weight: Lane::splat(1.0),
                overshoot_weight: 1.0,
            };
            let simulator = simulator(architecture);
            let (pressures, commands) = match simulator.model() {
                Model::StateSpace(model) => rollout(&model, &scenario, &controller),
                Model::Hybrid(model) => rollout(&model, &scenario, &controller),
                Model::Stitched(model) => rollout(&model, &scenario, &controller),
            };
            assert!((0..LANES).any(|l| commands[0][l].to_bits() != commands[ticks - 1][l].to_bits()));

            let mut lung = simulated_lung(&simulator, ticks);
            // Twice, since nothing of an inspiration may be left in the next one.
            for _ in 0..2 {
                lung.begin(&scenario.start, scenario.rest);
                for (tick, (pressure, command)) in pressures.iter().zip(&commands).enumerate() {
                    assert_eq!(lung.pressure(), *pressure, "tick {tick}");
                    lung.advance(command);
                }
            }
        }
    }
}
