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
    /// An array of another length than the environments need.
    #[error("the array of {array} has {given} numbers: it needs {needed}")]
    Length {
        /// Content of the array.
        array: &'static str,
        /// Its length.
        given: usize,
        /// The length that is needed.
        needed: usize,
    },
    /// There is nothing to run on.
    #[error("the task has no {0}: name at least one")]
    Empty(&'static str),
    /// A number that is out of bounds.
    #[error("{name} is {value}: it must be {least} to {most}")]
    OutOfBounds {
        /// Name of the option.
        name: &'static str,
        /// The value.
        value: f64,
        /// Lowest accepted value.
        least: f64,
        /// Highest accepted value.
        most: f64,
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

impl EnvironmentError {
    pub(crate) fn out_of_bounds<T: Into<f64>>(name: &'static str, value: T, least: T, most: T) -> Self {
        Self::OutOfBounds { name, value: value.into(), least: least.into(), most: most.into() }
    }
}
