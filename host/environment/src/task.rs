//! The task of an environment: what was configured, and what is built from it.

use serde::{Deserialize, Serialize};
use shared::breath::{Breath, DEFAULT_PERIOD_US, PAPER_PIPS};
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::settings::Settings;

use plant::bench::{BenchConfig, steps_per_period};
use ventilator::{SourceError, Tick};

use crate::action::Commanded;
use crate::observation::Observer;
use crate::plants::{Plants, Waveforms};
use crate::{ActionKind, EnvironmentError, ObservationKind};

/// Largest number of breaths in an episode.
const BREATHS_MAX: u32 = 100_000;

/// Error of a step that is missing because the ventilator broke the episode off, as a multiple of PIP - PEEP: more than that of a
/// valve that stays closed, so that an agent has nothing to gain from being broken off.
const MISSING: f64 = 2.0;

/// What an environment's episodes are like.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskConfig {
    /// Plants.
    pub plants: Plants,
    /// PIPs of the waveforms, which take turns, cmH2O; those of the paper or of the family if none.
    pub pips: Option<Vec<f32>>,
    /// All other settings; the defaults or those of the family if none.
    pub settings: Option<Settings>,
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
            pips: None,
            settings: None,
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

    /// The reward of a step that the ventilator did not run because it had broken the episode off.
    pub(crate) fn of_missing(&self, settings: &Settings) -> f64 {
        -self.error * MISSING * f64::from(settings.pip - settings.peep)
    }
}

/// A validated task.
#[derive(Clone, Debug)]
pub struct Task {
    pub(crate) config: TaskConfig,
    pub(crate) waveforms: Waveforms,
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
        let waveforms = waveforms(&config)?;
        steps_per_period(config.period_us).map_err(SourceError::from)?;
        bounded("hold", config.hold, 1000)?;
        bounded("breaths", config.breaths, BREATHS_MAX)?;
        let Reward { error, effort, overshoot } = config.reward;
        if let Some(value) =
            [error, effort, overshoot].into_iter().find(|weight| !(0.0..1e9).contains(weight))
        {
            let (name, bounds) = ("a weight of the reward", "a finite number of at least 0");
            return Err(EnvironmentError::OutOfBounds { name, value, bounds });
        }
        Ok(Self {
            law: config.action.law(config.period_us)?,
            observer: config.observation.observer(config.period_us)?,
            monitors: if config.monitors { Monitors::ALL } else { no_monitors() },
            waveforms,
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

    /// Steps of an episode that is not broken off.
    pub fn steps(&self) -> u32 {
        let settings = Settings { pip: self.waveforms.pips[0], ..self.waveforms.settings };
        let ticks =
            Breath::new(&settings, self.config.period_us).map_or(0, |breath| breath.inspiration_ticks());
        self.config.breaths * ticks.div_ceil(self.config.hold)
    }
}

fn waveforms(config: &TaskConfig) -> Result<Waveforms, EnvironmentError> {
    let (pips, settings) = match &config.plants {
        Plants::Family(family) => (family.pips.clone(), family.settings),
        Plants::Benches(_) => (PAPER_PIPS.to_vec(), Settings::default()),
    };
    let pips = config.pips.clone().unwrap_or(pips);
    let settings = config.settings.unwrap_or(settings);
    if pips.is_empty() {
        return Err(EnvironmentError::Empty("PIP"));
    }
    pips.iter().try_for_each(|pip| Settings { pip: *pip, ..settings }.validate())?;
    Ok(Waveforms { pips, settings })
}

fn bounded(name: &'static str, value: u32, most: u32) -> Result<(), EnvironmentError> {
    if (1..=most).contains(&value) {
        return Ok(());
    }
    let bounds = if most == BREATHS_MAX { "1 to 100000" } else { "1 to 1000 ticks" };
    Err(EnvironmentError::OutOfBounds { name, value: value.into(), bounds })
}

/// No monitor at all, for a bare plant.
pub fn no_monitors() -> Monitors {
    Fault::all().fold(Monitors::ALL, Monitors::without)
}
