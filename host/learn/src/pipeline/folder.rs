//! The folder of a run: what each stage leaves so that a stopped run can go on.
//!
//! ```text
//! run.json                     configuration: another one is refused
//! round-0/recording-P.parquet  breaths of the round, from plant P
//! round-0/recording-P.partial.parquet  what there was of them when the plant failed
//! round-0/simulator-P-N.safetensors, round-0/fit.json
//! round-0/training.json        checkpoint of the training
//! round-0/controller.safetensors, round-0/round.json
//! ```

use std::path::PathBuf;

use data::json::{self, JsonError};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::PipelineError;

/// A run's folder.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// A folder that may or may not exist yet.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// A file of a round.
    pub fn file(&self, round: usize, name: &str) -> PathBuf {
        self.path.join(format!("round-{round}")).join(name)
    }

    /// Takes the folder for this configuration.
    ///
    /// # Errors
    /// The folder holds a run with another one.
    pub(super) fn claim<T: PartialEq + Serialize + DeserializeOwned>(
        &self,
        configuration: &T,
    ) -> Result<(), PipelineError> {
        if json::claim(&self.path, configuration)? {
            Ok(())
        } else {
            Err(PipelineError::OtherRun(self.path.display().to_string()))
        }
    }

    /// What a stage left, if it did.
    pub(super) fn load<T: DeserializeOwned>(&self, round: usize, name: &str) -> Result<Option<T>, JsonError> {
        json::read(&self.file(round, name))
    }

    /// Leaves something.
    pub(super) fn save(&self, round: usize, name: &str, value: &impl Serialize) -> Result<(), JsonError> {
        json::write(&self.file(round, name), value)
    }
}
