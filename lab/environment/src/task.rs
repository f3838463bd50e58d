//! The task of an environment: what was configured, and what is built from it.

use serde::{Deserialize, Serialize};
use shared::breath::{Breath, DEFAULT_PERIOD_US};
use shared::control::COMMAND_MAX;
use shared::math;
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::settings::Settings;

use plant::bench::{BenchConfig, steps_per_period};
use plant::prescriptions::Prescriptions;
use ventilator::{SourceError, Tick};

use crate::action::Commanded;
use crate::observation::Observer;
use crate::plants::Plants;
use crate::{ActionKind, EnvironmentError, ObservationKind};

/// Longest time for which an action is held, ticks.
const HOLD_MAX: u32 = 1000;
/// Largest number of breaths in an episode.
const BREATHS_MAX: u32 = 100_000;
/// Largest weight of a part of the reward.
const WEIGHT_MAX: f64 = 1e9;

/// What an environment's episodes are like.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskConfig {
    /// Plants.
    pub plants: Plants,
    /// Settings of the breaths; the waveforms of the paper or of the family if none.
    pub prescriptions: Option<Prescriptions>,
    /// Whether the patients breathe.
    pub breathing: bool,
    /// Control period, microseconds.
    pub period_us: u32,
    /// Control ticks for which an action is held.
    pub hold: u32,
    /// Breaths of an episode.
    pub breaths: u32,
    /// What the agent observes.
    pub observation: ObservationKind,
    /// What an action commands.
    pub action: ActionKind,
    /// What the agent is rewarded for.
    pub reward: Reward,
    /// Whether the safety monitors are on.
    pub monitors: bool,
}

impl Default for TaskConfig {
    /// One breath on R20C20, with an action every 10 ms.
    fn default() -> Self {
        Self {
            plants: Plants::Benches(vec![BenchConfig::default()]),
            prescriptions: None,
            breathing: false,
            period_us: DEFAULT_PERIOD_US,
            hold: 10,
            breaths: 1,
            observation: ObservationKind::default(),
            action: ActionKind::Valve,
            reward: Reward::default(),
            monitors: true,
        }
    }
}

/// Weights of the reward of a tick. The reward of a step is the mean over the ticks for which its action is held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Reward {
    /// Penalty for an error of one cmH2O of the true airway pressure.
    pub error: f64,
    /// Penalty for a command that changes by one percent of the valve.
    pub effort: f64,
    /// Further penalty for a true pressure of one cmH2O above PIP.
    pub overshoot: f64,
}

impl Default for Reward {
    /// The score of the paper alone.
    fn default() -> Self {
        Self { error: 1.0, effort: 0.0, overshoot: 0.0 }
    }
}

impl Reward {
    /// The reward of a tick of an inspiration, after a command of `before` percent.
    pub(crate) fn of(&self, tick: &Tick, pip: f32, before: f32) -> f64 {
        let sample = tick.sample;
        let pressure = tick.truth.map_or(sample.pressure, |truth| truth.airway_pressure);
        let error = f64::from((pressure - sample.target).abs());
        let effort = f64::from((sample.u_in - before).abs());
        let overshoot = f64::from((pressure - pip).max(0.0));
        -(self.error * error + self.effort * effort + self.overshoot * overshoot)
    }

    /// The reward of a tick that the ventilator did not run because it had aborted the episode: the pressure is at its limit while the
    /// target is PEEP, and the command jumps over the whole range. Any policy does better in a tick that runs.
    pub(crate) fn worst(&self, settings: &Settings) -> f64 {
        let Settings { pip, peep, pressure_limit, .. } = *settings;
        let (error, overshoot) = (f64::from(pressure_limit - peep), f64::from(pressure_limit - pip));
        -(self.error * error + self.effort * f64::from(COMMAND_MAX) + self.overshoot * overshoot)
    }
}

/// A validated task.
#[derive(Clone, Debug)]
pub struct Task {
    pub(crate) config: TaskConfig,
    pub(crate) prescriptions: Prescriptions,
    pub(crate) law: Commanded,
    pub(crate) observer: Observer,
    pub(crate) monitors: Monitors,
}

impl Task {
    /// Validates a configuration.
    ///
    /// # Errors
    /// No plant, no waveform, or a value out of bounds.
    pub fn new(config: TaskConfig) -> Result<Self, EnvironmentError> {
        if matches!(&config.plants, Plants::Benches(benches) if benches.is_empty()) {
            return Err(EnvironmentError::Empty("plant"));
        }
        let prescriptions = prescriptions(&config)?;
        bounded("hold", config.hold, HOLD_MAX)?;
        bounded("breaths", config.breaths, BREATHS_MAX)?;
        let Reward { error, effort, overshoot } = config.reward;
        for weight in [error, effort, overshoot] {
            if !(0.0..=WEIGHT_MAX).contains(&weight) {
                return Err(EnvironmentError::out_of_bounds(
                    "a weight of the reward",
                    weight,
                    0.0,
                    WEIGHT_MAX,
                ));
            }
        }
        Ok(Self {
            law: config.action.law(config.period_us)?,
            observer: config.observation.observer(config.period_us)?,
            monitors: if config.monitors { Monitors::ALL } else { no_monitors() },
            prescriptions,
            config,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &TaskConfig {
        &self.config
    }

    /// Length of an observation.
    pub fn observations(&self) -> usize {
        self.config.observation.len()
    }

    /// Steps of the longest episode: of each one that is not aborted, unless the inspiratory time is drawn.
    pub fn steps(&self) -> u32 {
        self.steps_of(math::ticks(self.prescriptions.longest_inspiration(), self.config.period_us))
    }

    /// Steps of an episode whose inspirations have this many ticks, if it is not aborted.
    pub(crate) fn steps_of(&self, inspiration_ticks: u32) -> u32 {
        self.config.breaths * inspiration_ticks.div_ceil(self.config.hold)
    }
}

/// The prescriptions of a configuration, whose breaths can be run at its control period.
fn prescriptions(config: &TaskConfig) -> Result<Prescriptions, EnvironmentError> {
    steps_per_period(config.period_us).map_err(SourceError::from)?;
    let prescriptions = config.prescriptions.clone().unwrap_or_else(|| config.plants.usual());
    if prescriptions.are_listed() && prescriptions.pips.is_empty() {
        return Err(EnvironmentError::Empty("PIP"));
    }
    for number in 0..prescriptions.pips.len().max(1) {
        Breath::new(&prescriptions.draw(0, number as u32), config.period_us)?;
    }
    Ok(prescriptions)
}

fn bounded(name: &'static str, value: u32, most: u32) -> Result<(), EnvironmentError> {
    let sound = (1..=most).contains(&value);
    sound.then_some(()).ok_or_else(|| EnvironmentError::out_of_bounds(name, value, 1, most))
}

/// No monitor at all, for a bare plant.
pub fn no_monitors() -> Monitors {
    Fault::all().fold(Monitors::ALL, Monitors::without)
}
