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

use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::PipelineError;
use data::files::{claim, read_json, write_json};

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
        if claim(&self.path, configuration).map_err(failure(&self.path))? {
            Ok(())
        } else {
            Err(PipelineError::OtherRun(self.path.display().to_string()))
        }
    }

    /// What a stage left, if it did.
    pub(super) fn load<T: DeserializeOwned>(
        &self,
        round: usize,
        name: &str,
    ) -> Result<Option<T>, PipelineError> {
        let path = self.file(round, name);
        read_json(&path).map_err(failure(&path))
    }

    /// Leaves something.
    pub(super) fn save(&self, round: usize, name: &str, value: &impl Serialize) -> Result<(), PipelineError> {
        let path = self.file(round, name);
        write_json(&path, value).map_err(failure(&path))
    }
}

fn failure(path: &Path) -> impl FnOnce(io::Error) -> PipelineError {
    let path = path.display().to_string();
    move |reason| PipelineError::Folder { path, reason: reason.to_string() }
}
