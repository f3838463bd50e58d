//! Errors of a demo.

use std::io;
use std::path::{Path, PathBuf};

use shared::control::pid::GainError;
use shared::control::residual::ResidualError;
use thiserror::Error;

use data::recording::DatasetError;
use data::tensors::TensorError;
use learn::controller::learned::LearnedError;
use learn::pipeline::PipelineError;
use plant::bench::BenchError;
use score::baselines::TuneError;
use show::report::ReportError;
use ventilator::SourceError;

/// An error of a demo.
#[derive(Debug, Error)]
pub enum StudyError {
    /// The search for the best PID failed.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// Recording, fitting or training failed.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// An evaluation failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A bench description is not valid.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// PID gains are not valid.
    #[error(transparent)]
    Gain(#[from] GainError),
    /// A learned policy is not valid.
    #[error(transparent)]
    Policy(#[from] ResidualError),
    /// A recording could not be read or written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A simulator's file could not be read or written.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// A controller's file or image could not be read or written.
    #[error(transparent)]
    Learned(#[from] LearnedError),
    /// A report could not be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// Any other file could not be used.
    #[error("cannot use {path}: {source}")]
    #[expect(missing_docs, reason = "the message names every field")]
    File { path: PathBuf, source: io::Error },
    /// Stopped; the folder contains the results so far.
    #[error("stopped; run the same command again to continue")]
    Stopped,
    /// Stopped before the search for the best PID was complete.
    #[error("stopped during the search for the best PID: nothing was learned yet, run the command again")]
    SearchStopped,
}

/// Result of a study's steps.
pub(crate) type Result<T, E = StudyError> = std::result::Result<T, E>;

impl StudyError {
    /// Wraps an I/O error with the path of its file.
    pub(crate) fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }
}
