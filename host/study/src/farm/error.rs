//! What can go wrong with a farm, and which of it may pass by itself.

use std::io;
use std::path::{Path, PathBuf};

use shared::link::refusal::Refusal;
use thiserror::Error;

use data::recording::DatasetError;
use data::tensors::TensorError;
use device::DeviceError;
use device::simulated::ServeError;
use device::upload::UploadError;
use learn::controller::learned::LearnedError;
use learn::pipeline::PipelineError;
use score::baselines::TuneError;
use score::bound::BoundError;
use ventilator::SourceError;
use ventilator::collect::CollectError;

/// Why a farm, or one of its units, cannot go on.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum FarmError {
    /// The description is not valid, or a unit is not the one it describes.
    #[error("{line}: {message}")]
    Description { line: String, message: String },
    /// A file cannot be used.
    #[error("cannot use {}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// The folder belongs to another farm.
    #[error("{} contains a farm with other units, another seed or other settings: choose another folder", .0.display())]
    OtherFarm(PathBuf),
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
    /// A device in this process.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// A device.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A device as a source.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A collection.
    #[error(transparent)]
    Collect(#[from] CollectError),
    /// A recording.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A fit or a training.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A simulator's file.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// A controller's file.
    #[error(transparent)]
    Learned(#[from] LearnedError),
    /// An upload.
    #[error(transparent)]
    Upload(#[from] UploadError),
    /// The search for the best PID.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// The reference bound.
    #[error(transparent)]
    Bound(#[from] BoundError),
    /// Weights cannot be signed.
    #[error("cannot sign the weights: {0}")]
    Sign(String),
    /// Stopped.
    #[error("stopped; run the same command again to continue")]
    Stopped,
}

impl FarmError {
    pub(super) fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }

    /// Whether the unit may come back by itself, as after a loose plug.
    pub(super) fn may_pass(&self) -> bool {
        let source = match self {
            Self::Source(source) | Self::Collect(CollectError::Source(source)) => source,
            Self::Upload(UploadError::Device(device)) | Self::Device(device) => {
                return device_may_return(device);
            }
            _ => return false,
        };
        match source {
            SourceError::Device(device) | SourceError::Upload(UploadError::Device(device)) => {
                device_may_return(device)
            }
            SourceError::Lost { .. } | SourceError::Silent { .. } => true,
            _ => false,
        }
    }
}

/// Whether a device that failed so may come back by itself. The lease of a connection that broke lapses.
fn device_may_return(error: &DeviceError) -> bool {
    match error {
        DeviceError::Port(_) | DeviceError::Silent(_) | DeviceError::Gone(_) => true,
        DeviceError::Refused(refusal) => matches!(refusal, Refusal::Lease { .. } | Refusal::NoLease),
        _ => false,
    }
}
