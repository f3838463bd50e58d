//! Errors of the experiments.

use shared::control::pid::GainError;
use shared::control::residual::ResidualError;
use thiserror::Error;

use data::recording::DatasetError;
use data::tensors::TensorError;
use data::workspace::WorkspaceError;
use laws::rivals::parameter::RivalError;
use learn::controller::learned::LearnedError;
use learn::pipeline::PipelineError;
use plant::bench::BenchError;
use plant::bench::family::FamilyError;
use score::baselines::TuneError;
use score::bound::BoundError;
use show::report::ReportError;
use trials::robust::RobustError;
use ventilator::SourceError;

/// An error of the experiments.
#[derive(Debug, Error)]
pub enum PaperError {
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
    /// The reference bound.
    #[error(transparent)]
    Bound(#[from] BoundError),
    /// A family of plants is not valid.
    #[error(transparent)]
    Family(#[from] FamilyError),
    /// The best PID of a family is not known.
    #[error(transparent)]
    Robust(#[from] RobustError),
    /// Parameters of a rival are not valid.
    #[error(transparent)]
    Rival(#[from] RivalError),
    /// The program has no controller with this name.
    #[error("no controller {0} comes with this program")]
    NotShipped(&'static str),
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
    /// The folder belongs to another run, or a file cannot be used.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
    /// Stopped; the folder contains the results so far.
    #[error("stopped; run the same command again to continue")]
    Stopped,
}

/// Result of a study's steps.
pub(crate) type Result<T, E = PaperError> = std::result::Result<T, E>;
