//! What can go wrong with a study.

use shared::control::pid::GainError;
use shared::control::residual::ResidualError;
use thiserror::Error;

use data::recording::DatasetError;
use data::tensors::TensorError;
use data::workspace::WorkspaceError;
use device::DeviceError;
use device::simulated::ServeError;
use device::upload::UploadError;
use learn::controller::learned::LearnedError;
use learn::pipeline::PipelineError;
use plant::bench::BenchError;
use plant::bench::family::FamilyError;
use score::baselines::TuneError;
use score::bound::BoundError;
use show::report::ReportError;
use ventilator::SourceError;
use ventilator::collect::CollectError;

/// Why a study, or one of a farm's units, cannot go on.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum StudyError {
    /// The description of a farm is not valid, or a unit is not the one it describes.
    #[error("{line}: {message}")]
    Description { line: String, message: String },
    /// The ventilator's safe state ended too many breaths.
    #[error(
        "the ventilator's safe state ended {0} breath(s): check lung and sensor of this unit, or lower the highest of --pips, then run the same command again"
    )]
    Aborted(usize),
    /// The sensor cannot be corrected.
    #[error("the calibration is refused: {0}")]
    Calibration(String),
    /// The device does not hold what was stored.
    #[error(
        "the device does not hold the {0} that was stored on it: check its flash and the supply, then run the same command again"
    )]
    NotStored(&'static str),
    /// No unit has what the next stage needs.
    #[error("no unit has a simulator that describes it: see the problems of the units")]
    NoUnit,
    /// The folder belongs to another run, or a file cannot be used.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
    /// The search for the best PID failed.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// The search for the reference bound failed.
    #[error(transparent)]
    Bound(#[from] BoundError),
    /// Recording, fitting or training failed.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A collection failed.
    #[error(transparent)]
    Collect(#[from] CollectError),
    /// A device in this process failed.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// A device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A source of breaths failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// An upload failed.
    #[error(transparent)]
    Upload(#[from] UploadError),
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
    /// Weights cannot be signed.
    #[error("cannot sign the weights: {0}")]
    Sign(String),
    /// A family of plants is not valid.
    #[error(transparent)]
    Family(#[from] FamilyError),
    /// Work that only some studies do failed.
    #[error(transparent)]
    Other(Box<dyn std::error::Error + Send + Sync>),
    /// Stopped; the folder contains the results so far.
    #[error("stopped; run the same command again to continue")]
    Stopped,
    /// Stopped before the search for the best PID was complete.
    #[error("stopped during the search for the best PID: nothing was learned yet, run the command again")]
    SearchStopped,
}

/// Result of a study's steps.
pub type Result<T, E = StudyError> = std::result::Result<T, E>;

impl StudyError {
    /// Wraps an error of work that only some studies do.
    pub fn other(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Other(Box::new(error))
    }
}
