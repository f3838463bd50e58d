//! What an agent observes: the inputs of a learned controller of ours or of the paper's authors, or plain values.

use laws::rl::ventilation::{Perception, PolicyMemory, TaskConfig as Features};
use learn::controller::ControllerArchitecture;
use learn::controller::authors::averages::{ERRORS, averages};
use learn::controller::authors::spacing_ticks;
use serde::{Deserialize, Serialize};
use shared::breath::{PERIOD_BOUNDS_US, period_s};
use shared::control::Observation;
use shared::control::features::{ERROR_SCALE, FEATURES};

use crate::EnvironmentError;

/// Length of a plain observation.
const PLAIN: usize = 6;
/// Length of the longest observation.
const LONGEST: usize = FEATURES;

/// What an agent observes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ObservationKind {
    /// The 25 features of our residual controller: errors and commands of the last 64 ms, their leaky averages, an integral, the time
    /// since the breath started, PIP, PEEP and where the target goes, each scaled to about one.
    #[default]
    Ours,
    /// The ten inputs of the paper authors' network: running averages of the last ten errors, 10 ms apart, in units of 10 cmH2O.
    Authors,
    /// Measured pressure, target, PIP and PEEP in cmH2O, last command in percent, time since the breath started in s.
    Plain,
}

impl ObservationKind {
    /// Length of the observation.
    pub const fn len(self) -> usize {
        match self {
            Self::Ours => FEATURES,
            Self::Authors => ERRORS,
            Self::Plain => PLAIN,
        }
    }

    /// The kind with this name.
    ///
    /// # Errors
    /// A name of none.
    pub fn from_name(name: &str) -> Result<Self, EnvironmentError> {
        let kinds = [("ours", Self::Ours), ("authors", Self::Authors), ("plain", Self::Plain)];
        let kind = kinds.into_iter().find(|(known, _)| *known == name);
        kind.map(|(_, kind)| kind).ok_or_else(|| EnvironmentError::Observation(name.to_owned()))
    }

    /// Never: an observation has values.
    pub const fn is_empty(self) -> bool {
        false
    }

    /// What computes the observation at a control period in microseconds.
    pub(crate) fn observer(self, period_us: u32) -> Result<Observer, EnvironmentError> {
        let (shortest, longest) = PERIOD_BOUNDS_US;
        if !(shortest..=longest).contains(&period_us) {
            return Err(EnvironmentError::out_of_bounds("period_us", period_us, shortest, longest));
        }
        Ok(match self {
            Self::Ours => Observer::Ours(Box::new(Perception::new(&Features::default(), period_us)?)),
            Self::Authors => {
                let spacing_us = match ControllerArchitecture::authors(period_us) {
                    ControllerArchitecture::Authors { error_spacing_us } => error_spacing_us,
                    ControllerArchitecture::Ours => period_us,
                };
                Observer::Authors { spacing: spacing_ticks(spacing_us, period_us) }
            }
            Self::Plain => Observer::Plain { period_s: period_s(period_us) },
        })
    }
}

/// The observations of an environment, tick by tick, for an agent that was trained there and runs elsewhere.
#[derive(Clone, Debug)]
pub struct ObservationStream {
    kind: ObservationKind,
    observer: Observer,
    memory: Memory,
}

impl ObservationStream {
    /// Observations of this kind at a control period in microseconds.
    ///
    /// # Errors
    /// A control period that does not suit the features.
    pub fn new(kind: ObservationKind, period_us: u32) -> Result<Self, EnvironmentError> {
        Ok(Self { kind, observer: kind.observer(period_us)?, memory: Memory::default() })
    }

    /// Starts a breath; the last command was `command` percent.
    pub fn start_breath(&mut self, command: f32) {
        self.observer.start_breath(&mut self.memory, command);
    }

    /// Observes a tick of an inspiration.
    pub fn see(&mut self, seen: &Observation) -> &[f32] {
        self.observer.see(&mut self.memory, seen);
        &self.memory.seen[..self.kind.len()]
    }

    /// Records the command applied in the tick, percent.
    pub fn applied(&mut self, command: f32) {
        self.observer.applied(&mut self.memory, command);
    }
}

/// Computes observations.
#[derive(Clone, Debug)]
pub(crate) enum Observer {
    Ours(Box<Perception>),
    Authors {
        /// Time between two errors, ticks.
        spacing: usize,
    },
    Plain {
        period_s: f32,
    },
}

/// What an observer remembers of a breath, and its last observation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory {
    policy: PolicyMemory,
    /// Scaled errors of the breath, tick by tick.
    errors: Vec<f32>,
    command: f32,
    seen: [f32; LONGEST],
}

impl Observer {
    /// Clears the memory for a new breath; the valve is at `command` percent.
    pub(crate) fn start_breath(&self, memory: &mut Memory, command: f32) {
        match self {
            Self::Ours(perception) => perception.start_breath(&mut memory.policy, command),
            Self::Authors { .. } => memory.errors.clear(),
            Self::Plain { .. } => memory.command = command,
        }
    }

    /// Observes a tick.
    pub(crate) fn see(&self, memory: &mut Memory, seen: &Observation) {
        match self {
            Self::Ours(perception) => memory.seen = perception.see(&mut memory.policy, seen),
            Self::Authors { spacing } => {
                memory.errors.push((seen.target - seen.pressure) / ERROR_SCALE);
                let newest = memory.errors.len() - 1;
                let past =
                    |count: usize| newest.checked_sub(count * spacing).map_or(0.0, |at| memory.errors[at]);
                let averages = averages(&std::array::from_fn(past));
                memory.seen[..ERRORS].copy_from_slice(&averages);
            }
            Self::Plain { period_s } => {
                let Observation { pressure, target, pip, peep, tick, .. } = *seen;
                let time = tick as f32 * period_s;
                memory.seen[..PLAIN].copy_from_slice(&[pressure, target, pip, peep, memory.command, time]);
            }
        }
    }

    /// Records the command applied in the tick, percent.
    pub(crate) fn applied(&self, memory: &mut Memory, command: f32) {
        match self {
            Self::Ours(perception) => perception.applied(&mut memory.policy, command),
            Self::Authors { .. } => {}
            Self::Plain { .. } => memory.command = command,
        }
    }
}

impl Memory {
    /// The last observation, filled up with zeros.
    pub(crate) fn seen(&self) -> &[f32; LONGEST] {
        &self.seen
    }
}
