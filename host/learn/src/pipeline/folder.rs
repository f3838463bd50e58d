//! The folder of a run: the results of each stage, from which a stopped run continues.
//!
//! ```text
//! run.json                     configuration; a run with a different one is refused
//! round-0/recording-P.parquet  breaths of the round, from plant P
//! round-0/recording-P.partial.parquet  the breaths before the plant failed
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

/// The folder of a run.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// A folder, which need not exist yet.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Path of a file of a round.
    pub fn file(&self, round: usize, name: &str) -> PathBuf {
        self.path.join(format!("round-{round}")).join(name)
    }

    /// Path of a file of the whole run.
    pub fn whole(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Claims the folder for this configuration.
    ///
    /// # Errors
    /// The folder contains a run with another configuration.
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

    /// The result that a stage saved, if it did.
    pub(super) fn load<T: DeserializeOwned>(
        &self,
        round: usize,
        name: &str,
    ) -> Result<Option<T>, PipelineError> {
        let path = self.file(round, name);
        read_json(&path).map_err(failure(&path))
    }

    /// Saves the result of a stage.
    pub(super) fn save(&self, round: usize, name: &str, value: &impl Serialize) -> Result<(), PipelineError> {
        let path = self.file(round, name);
        write_json(&path, value).map_err(failure(&path))
    }
}

fn failure(path: &Path) -> impl FnOnce(io::Error) -> PipelineError {
    let path = path.display().to_string();
    move |reason| PipelineError::Folder { path, reason: reason.to_string() }
}
