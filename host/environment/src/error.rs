//! Why an environment was refused or cannot go on.

use shared::control::pid::GainError;
use shared::control::residual::ResidualError;
use shared::settings::SettingsError;
use thiserror::Error;
use ventilator::SourceError;

/// Why an environment was refused or cannot go on.
#[derive(Debug, Error)]
pub enum EnvironmentError {
    /// The action is not a finite number.
    #[error("the action is {0}: give a finite number from -1 to 1")]
    Action(f32),
    /// There is no observation of this name.
    #[error("there is no observation {0}: choose ours, authors or plain")]
    Observation(String),
    /// No episode is running.
    #[error("no episode is running: call reset first")]
    Ended,
    /// A number of actions, observations or seeds that differs from that of the environments.
    #[error("{given} {what} for {wanted} environments: give one for each")]
    Count {
        /// What was given.
        what: &'static str,
        /// How many were given.
        given: usize,
        /// How many are needed.
        wanted: usize,
    },
    /// There is nothing to run on.
    #[error("the task has no {0}: name at least one")]
    Empty(&'static str),
    /// A number that is out of bounds.
    #[error("{name} is {value}: it must be {bounds}")]
    OutOfBounds {
        /// What it is.
        name: &'static str,
        /// The value.
        value: f64,
        /// The bounds in words.
        bounds: &'static str,
    },
    /// Threads that cannot be started.
    #[error("cannot start {threads} threads: {reason}; ask for fewer")]
    Threads {
        /// The number of threads.
        threads: usize,
        /// The system's reason.
        reason: String,
    },
    /// Settings that are refused.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// Gains of the PID that are refused.
    #[error(transparent)]
    Gains(#[from] GainError),
    /// Features that do not suit the control period.
    #[error(transparent)]
    Features(#[from] ResidualError),
    /// The ventilator or the bench failed.
    #[error(transparent)]
    Source(#[from] SourceError),
}
