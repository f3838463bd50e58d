//! Why a demo or a reproduction cannot be finished.

use std::io;
use std::path::{Path, PathBuf};

use shared::control::pid::GainError;
use shared::control::residual::ResidualError;
use thiserror::Error;

use data::recording::DatasetError;
use data::tensors::TensorError;
use judge::baselines::TuneError;
use judge::bound::BoundError;
use learn::controller::learned::LearnedError;
use learn::pipeline::PipelineError;
use plant::bench::BenchError;
use show::report::ReportError;
use ventilator::SourceError;

/// Why a study cannot be finished.
#[derive(Debug, Error)]
pub enum StudyError {
    /// Search of a PID.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// Learning.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// Evaluation.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A bench.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The reference bound.
    #[error(transparent)]
    Bound(#[from] BoundError),
    /// Gains.
    #[error(transparent)]
    Gain(#[from] GainError),
    /// A policy.
    #[error(transparent)]
    Policy(#[from] ResidualError),
    /// Recording.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Simulator's file.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// Controller's file or image.
    #[error(transparent)]
    Learned(#[from] LearnedError),
    /// Report.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The folder holds another run.
    #[error(
        "{0} holds a run with another seed, budget or choice of lungs; choose another folder or remove it"
    )]
    OtherRun(String),
    /// Another file.
    #[error("cannot use {path}: {source}")]
    #[expect(missing_docs, reason = "the message names every field")]
    File { path: PathBuf, source: io::Error },
    /// Stopped where the folder holds what was done.
    #[error("stopped; the same command goes on from here")]
    Stopped,
    /// Stopped before the search was done.
    #[error("stopped during the search of the best PID; nothing was learned yet, start again")]
    SearchStopped,
}

/// What a study gives, if it can.
pub(crate) type Result<T, E = StudyError> = std::result::Result<T, E>;

impl StudyError {
    /// What the system says about a file.
    pub(crate) fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }
}
