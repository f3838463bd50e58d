//! The inspiration as a task: an agent controls the valve of a learned simulator; the reward falls with the error.
//!
//! An episode is one inspiration at a PIP drawn from the waveforms. The agent observes the features of our residual
//! controller, computed by the same code from the same noisy readings; its action is the whole command, without a PID
//! underneath.
//!
//! Readings are taken and features advance every control tick, but an action is held for several ticks, 10 ms by
//! default, to ease credit assignment: dead time and lag of the valve delay the effect of an action by tens of
//! milliseconds. With an action per tick, its effect would have to be separated from that of forty others, and random
//! exploration would average out in the valve's lag.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};
use shared::breath::PAPER_PIPS;
use shared::control::features::{FEATURES, FeatureSpec, FeatureState, Features};
use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::residual::ResidualError;
use shared::control::{COMMAND_MAX, Observation};
use shared::math;

use super::{Actions, End, TaskBatch, Transition};
use engine::{LANES, Lane};
use learn::simulator::BreathStart;
use learn::simulator::model::{Model, Simulator};
use learn::simulator::rollout::Rollout;

/// Observations, timing and rewards of an agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TaskConfig {
    /// Time for which an action is held, s; at least one control tick.
    pub hold_time: f32,
    /// Number of commands for discrete actions, evenly spaced from 0 to 100 %. With 41 the pressure chatters about its
    /// plateau less than with 21.
    pub levels: usize,
    /// Gain of the integral among the agent's features, percent per cmH2O and second.
    pub integral_gain: f32,
    /// Penalty for an error of one cmH2O while an action is held.
    pub reward_scale: f32,
    /// PIPs of the waveforms, cmH2O.
    pub pips: Vec<f32>,
    /// PEEP (positive end-expiratory pressure), cmH2O.
    pub peep: f32,
    /// Command before the inspiration, percent.
    pub rest: f32,
    /// Inspiratory time, s.
    pub inspiratory_time: f32,
    /// Standard deviation of the starting pressure, cmH2O.
    pub start_spread: f32,
}

impl Default for TaskConfig {
    fn default() -> Self {
        Self {
            hold_time: 0.01,
            levels: 41,
            integral_gain: 20.0,
            reward_scale: 0.1,
            pips: PAPER_PIPS.to_vec(),
            peep: 5.0,
            rest: 5.0,
            inspiratory_time: 1.0,
            start_spread: 0.05,
        }
    }
}

/// How an agent observes and acts, on simulator and bench alike.
#[derive(Clone, Debug, PartialEq)]
pub struct Perception {
    /// Control period, microseconds.
    pub period_us: u32,
    /// Number of control ticks for which an action is held.
    pub hold: u32,
    features: Features,
    integral: Pid,
}

/// An agent's memory of a breath.
#[derive(Clone, Debug, Default)]
pub struct PolicyMemory {
    features: FeatureState,
    integral: PidState,
}

impl Perception {
    /// The perception at a control period in microseconds.
    ///
    /// # Errors
    /// A gain or feature out of range.
    pub fn new(config: &TaskConfig, period_us: u32) -> Result<Self, ResidualError> {
        let gains = PidGains { p: 0.0, i: config.integral_gain, d: 0.0 };
        Ok(Self {
            period_us,
            hold: math::ticks(config.hold_time, period_us).max(1),
            features: Features::new(FeatureSpec::for_period(period_us), period_us)?,
            integral: Pid::new(gains, period_us)?,
        })
    }

    /// Clears the memory for a new breath; the valve is at `command` percent.
    pub fn start_breath(&self, memory: &mut PolicyMemory, command: f32) {
        memory.features.start_breath(command);
        memory.integral = PidState::new();
    }

    /// Processes the observation of a tick; returns the agent's features.
    pub fn see(&self, memory: &mut PolicyMemory, seen: &Observation) -> [f32; FEATURES] {
        let features = self.features.step(&mut memory.features, seen, memory.integral.integral);
        // A PID with only an integral part; its command is unused, its integral is the feature.
        self.integral.step(&mut memory.integral, seen, 0.0);
        features
    }

    /// Records the command applied in the tick, percent.
    pub fn applied(&self, memory: &mut PolicyMemory, command: f32) {
        self.features.applied(&mut memory.features, command);
    }
}

/// The command of the inspiratory valve that an action asks for, percent: a continuous action from -1 (closed) to 1 (open), or the
/// index of a level. An action beyond that range is limited to it, and NaN closes the valve.
pub fn valve_command(actions: Actions, action: f32) -> f32 {
    let share = match actions {
        Actions::Continuous => 0.5 + 0.5 * action,
        Actions::Discrete(levels) => action / levels.saturating_sub(1).max(1) as f32,
    };
    math::limit(COMMAND_MAX * share, 0.0, COMMAND_MAX)
}

/// Inspirations on learned simulators, a shard at a time; simulators take turns.
pub struct Inspirations {
    config: TaskConfig,
    actions: Actions,
    perception: Perception,
    simulators: Vec<(Model, Simulator)>,
    running: usize,
    /// Rollout of the current simulator.
    rollout: Rollout,
    ticks: usize,
    tick: usize,
    pip: Lane,
    noise: Vec<Lane>,
    memories: [PolicyMemory; LANES],
    seen: [Lane; FEATURES],
    /// Sum of the absolute errors since the start of the inspiration, cmH2O.
    strayed: Lane,
}

impl Inspirations {
    /// Inspirations on `simulators`, commanded by `actions`. Call `reset` before the first step.
    ///
    /// # Errors
    /// Features or gains out of range.
    ///
    /// # Panics
    /// Without a simulator, with simulators of different control periods, or without a PIP.
    pub fn new(
        simulators: &[Simulator],
        config: &TaskConfig,
        actions: Actions,
    ) -> Result<Self, ResidualError> {
        assert!(!simulators.is_empty() && !config.pips.is_empty(), "a task needs simulators and waveforms");
        let period_us = simulators[0].architecture.timing().period_us;
        let alike = simulators.iter().all(|s| s.architecture.timing().period_us == period_us);
        assert!(alike, "simulators of one control period");
        let ticks = math::ticks(config.inspiratory_time, period_us) as usize;
        let simulators: Vec<_> = simulators.iter().map(|s| (s.model(), s.clone())).collect();
        Ok(Self {
            perception: Perception::new(config, period_us)?,
            rollout: Rollout::new(&simulators[0].0, ticks),
            simulators,
            config: config.clone(),
            actions,
            running: 0,
            ticks,
            tick: 0,
            pip: Lane::ZERO,
            noise: vec![Lane::ZERO; ticks],
            memories: std::array::from_fn(|_| PolicyMemory::default()),
            seen: [Lane::ZERO; FEATURES],
            strayed: Lane::ZERO,
        })
    }

    /// How the agents observe and act.
    pub fn perception(&self) -> &Perception {
        &self.perception
    }

    /// Starts inspirations at these PIPs, cmH2O, on the next simulator.
    pub fn begin(&mut self, pip: Lane, rng: &mut ChaCha8Rng) {
        let mut normal = |sd: f32| -> f32 { sd * rng.sample::<f32, _>(StandardNormal) };
        self.running = (self.running + 1) % self.simulators.len();
        let (model, simulator) = &self.simulators[self.running];
        let pressure = Lane::from_fn(|_| simulator.start_pressure + normal(self.config.start_spread));
        let start = BreathStart { pressure, plateau: pip, ..BreathStart::default() };
        self.rollout.begin(model, &start, &Lane::splat(self.config.rest));
        self.noise.fill_with(|| Lane::from_fn(|_| normal(simulator.noise)));
        (self.pip, self.tick, self.strayed) = (pip, 0, Lane::ZERO);
        for memory in &mut self.memories {
            self.perception.start_breath(memory, self.config.rest);
        }
        self.sense();
    }

    /// Mean absolute error of each inspiration so far, cmH2O.
    pub fn scores(&self) -> Lane {
        self.strayed.map(|sum| sum / self.tick.max(1) as f32)
    }

    /// Processes the readings of the present tick.
    fn sense(&mut self) {
        let pressure = self.rollout.pressure();
        for (l, memory) in self.memories.iter_mut().enumerate() {
            let seen = Observation {
                pressure: pressure[l] + self.noise[self.tick][l],
                target: self.pip[l],
                pip: self.pip[l],
                peep: self.config.peep,
                tick: self.tick as u32,
                rise_ticks: 0,
            };
            for (lane, feature) in self.seen.iter_mut().zip(self.perception.see(memory, &seen)) {
                lane[l] = feature;
            }
        }
    }

    /// Runs one tick with a command; returns the absolute error, cmH2O.
    fn tick(&mut self, command: &Lane) -> Lane {
        let error = self.rollout.pressure().zip(&self.pip, |p, target| (p - target).abs());
        self.rollout.advance(command);
        for (l, memory) in self.memories.iter_mut().enumerate() {
            self.perception.applied(memory, command[l]);
        }
        self.tick += 1;
        if self.tick < self.ticks {
            self.sense();
        }
        error
    }
}

impl TaskBatch for Inspirations {
    fn observations(&self) -> usize {
        FEATURES
    }

    fn actions(&self) -> Actions {
        self.actions
    }

    /// All inspirations end together, so all start together.
    fn reset(&mut self, ended: &[bool; LANES], rng: &mut ChaCha8Rng) {
        if ended.contains(&true) {
            let pips = &self.config.pips;
            let pip = Lane::from_fn(|_| pips[rng.random_range(0..pips.len())]);
            self.begin(pip, rng);
        }
    }

    fn step(&mut self, actions: &Lane) -> [Transition; LANES] {
        let command = actions.map(|action| valve_command(self.actions, action));
        let held = (self.perception.hold as usize).min(self.ticks - self.tick);
        let mut strayed = Lane::ZERO;
        for _ in 0..held {
            strayed.add_scaled(1.0, &self.tick(&command));
        }
        self.strayed.add_scaled(1.0, &strayed);
        let end = if self.tick < self.ticks { End::Not } else { End::Terminal };
        let scale = -self.config.reward_scale / held as f32;
        strayed.map(|sum| scale * sum).0.map(|reward| Transition { reward, end })
    }

    fn observe(&self, observation: &mut [Lane]) {
        observation.copy_from_slice(&self.seen);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use learn::simulator::first_order;
    use rand_chacha::rand_core::SeedableRng;
    use shared::control::features::INTEGRAL;

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(3)
    }

    fn inspirations(simulators: u8, config: &TaskConfig) -> Inspirations {
        let simulators: Vec<Simulator> =
            (0..simulators).map(|n| first_order(1.0 + 0.1 * f32::from(n))).collect();
        let mut task = Inspirations::new(&simulators, config, Actions::Discrete(config.levels)).unwrap();
        task.reset(&[true; LANES], &mut rng());
        task
    }

    #[test]
    fn actions_cover_the_valves_range() {
        let continuous =
            [-1.5, -1.0, 0.0, 1.0, 2.0].map(|action| valve_command(Actions::Continuous, action) as i32);
        assert_eq!(continuous, [0, 0, 50, 100, 100]);
        let levels = [0.0, 1.0, 10.0, 20.0].map(|action| valve_command(Actions::Discrete(21), action) as i32);
        assert_eq!(levels, [0, 5, 50, 100]);
        assert!(
            valve_command(Actions::Continuous, f32::NAN).abs() < f32::EPSILON,
            "no number closes the valve"
        );
    }

    #[test]
    fn an_inspiration_of_a_second_takes_a_hundred_actions() {
        let mut task = inspirations(1, &TaskConfig::default());
        let ends: Vec<End> = (0..100).map(|_| task.step(&Lane::splat(8.0))[0].end).collect();
        assert!(ends[..99].iter().all(|end| *end == End::Not));
        assert_eq!(ends[99], End::Terminal);
    }

    #[test]
    fn the_last_action_is_held_for_the_ticks_that_are_left() {
        let config = TaskConfig { hold_time: 0.03, inspiratory_time: 0.1, ..TaskConfig::default() };
        let mut task = inspirations(1, &config);
        let steps = (1..100).find(|_| task.step(&Lane::ZERO)[0].end == End::Terminal);
        assert_eq!((steps, task.tick), (Some(4), 100));
    }

    #[test]
    fn the_lung_of_the_tests_is_what_it_says() {
        let mut task = inspirations(1, &TaskConfig::default());
        for _ in 0..60 {
            task.step(&Lane::splat(20.0));
        }
        let pressure = task.rollout.pressure();
        assert!(pressure.0.iter().all(|p| (p - 35.0).abs() < 0.01), "{pressure:?}");
    }

    #[test]
    fn rewards_sum_up_to_the_score() {
        let config = TaskConfig { reward_scale: 1.0, ..TaskConfig::default() };
        let mut task = inspirations(1, &config);
        let mut total = Lane::ZERO;
        for _ in 0..100 {
            let transitions = task.step(&Lane::splat(12.0));
            total = Lane::from_fn(|l| total[l] + transitions[l].reward);
        }
        for l in 0..LANES {
            assert!((total[l] / 100.0 + task.scores()[l]).abs() < 1e-3 * task.scores()[l]);
        }
    }

    #[test]
    fn the_agent_sees_the_features_of_the_residual_controller() {
        let mut task = inspirations(1, &TaskConfig::default());
        let features = Features::new(FeatureSpec::default(), 1000).unwrap();
        let mut state = FeatureState::new();
        state.start_breath(5.0);
        let model = first_order(1.0).model();
        let mut lung = Rollout::new(&model, 1000);
        let start =
            BreathStart { pressure: task.rollout.pressure(), plateau: task.pip, ..BreathStart::default() };
        lung.begin(&model, &start, &Lane::splat(5.0));
        for tick in 0..=10 {
            let (pressure, pip) = (lung.pressure()[2] + task.noise[tick as usize][2], task.pip[2]);
            let seen = Observation { pressure, target: pip, pip, peep: 5.0, tick, rise_ticks: 0 };
            let expected = features.step(&mut state, &seen, 0.0);
            if tick == 10 {
                task.step(&Lane::splat(16.0));
            }
            if tick % 10 == 0 {
                let mut got = [Lane::ZERO; FEATURES];
                task.observe(&mut got);
                for (n, (got, expected)) in
                    got.iter().zip(expected).enumerate().filter(|(n, _)| *n != INTEGRAL)
                {
                    assert!((got[2] - expected).abs() < 1e-6, "feature {n} at tick {tick}");
                }
            }
            features.applied(&mut state, 40.0);
            lung.advance(&Lane::splat(40.0));
        }
        let integral: f32 = task.seen[INTEGRAL][2];
        assert!(integral > 0.0, "the pressure was below its target");
    }

    #[test]
    fn episodes_take_turns_on_the_simulators_and_draw_all_waveforms() {
        let mut task = inspirations(2, &TaskConfig::default());
        let mut rng = rng();
        let mut drawn = Vec::new();
        let first = task.running;
        for episode in 1..=10 {
            task.reset(&[true; LANES], &mut rng);
            assert_eq!(task.running, (first + episode) % 2);
            drawn.extend(task.pip.0);
        }
        assert!(PAPER_PIPS.iter().all(|pip| drawn.contains(pip)));
        assert!(drawn.iter().all(|pip| PAPER_PIPS.contains(pip)));
    }
}
