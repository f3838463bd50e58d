//! Sources of samples: one trait for the ventilator in this process, on any plant, and for devices at a port.
//!
//! A [`Source`] is a complete *ventilator*: it takes settings and a controller and runs breaths on its own clock. The
//! host receives one sample per control tick.

#![forbid(unsafe_code)]

pub mod collect;
mod in_process;
pub mod law;
mod port;
pub mod seeds;
#[cfg(all(test, unix))]
mod tests;
#[cfg(unix)]
mod virtual_board;

pub use in_process::{BalloonSource, BenchSource, InProcess, PlantSource, RunningBreath, SharedLink};
pub use port::PortSource;

use shared::control::Controller;
use shared::explore::Exploration;
use shared::explore::sines::{SineSweep, SweepError};
use shared::safety::alarms::Fault;
use shared::settings::{Settings, SettingsError};
use shared::ventilator::Sample;
use thiserror::Error;

use device::DeviceError;
use device::upload::UploadError;
use plant::TickTruth;
use plant::bench::BenchError;
use plant::link::PlantError;

/// Time that the lung rests after a fault vented it, before the next breath, s.
const REST_TIME: f32 = 3.0;

/// One control tick as seen by the host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// The ventilator's sample.
    pub sample: Sample,
    /// The true state of the plant, if it reports one.
    pub truth: Option<TickTruth>,
}

/// Why a source stopped delivering samples.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The ventilator entered its safe state.
    #[error(
        "the ventilator entered its safe state ({fault:?}) in breath {breath} at tick {tick}: check lung, pressure limit and controller"
    )]
    Fault {
        /// The fault.
        fault: Fault,
        /// Number of the breath.
        breath: u32,
        /// Tick within the breath.
        tick: u32,
    },
    /// Settings were refused.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A sweep of sines was refused.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// The bench cannot be built or run.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The plant behind the plant link failed.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The virtual board failed.
    #[cfg(unix)]
    #[error(transparent)]
    Emulator(#[from] emulator::EmulatorError),
    /// The weights could not be uploaded.
    #[error(transparent)]
    Upload(#[from] UploadError),
    /// Samples are missing.
    #[error(
        "samples were lost on the line at breath {breath}, tick {tick}; the recording up to there is valid: try a shorter cable or another port"
    )]
    Lost {
        /// Breath of the first missing sample.
        breath: u32,
        /// Tick of the first missing sample.
        tick: u32,
    },
    /// The device sends what no sound device can send.
    #[error("the device sends {what} in breath {breath}; compare it with docs/DEVICE_LINK.md")]
    Impossible {
        /// What it sends, in words.
        what: String,
        /// The current breath.
        breath: u32,
    },
    /// No sample of the first breath came.
    #[error(
        "the device never sent tick 0 of breath 0 after its start: both count from 0 (docs/DEVICE_LINK.md)"
    )]
    NotBegun,
    /// The device does not run the controller that was asked for.
    #[error(
        "the device runs {runs}, not {asked}, and does not change it: choose its own with --gains, or add SetController to it (docs/DEVICE_LINK.md)"
    )]
    OtherController {
        /// The controller that runs.
        runs: String,
        /// The one that was asked for.
        asked: String,
    },
    /// The device stopped sending.
    #[error("the device stopped sending samples in breath {breath}: check it with `trainer identify`")]
    Silent {
        /// The current breath.
        breath: u32,
    },
    /// The controller cannot run on this plant or device.
    #[error("the controller cannot run here: {0}")]
    Controller(String),
    /// The user asked to stop.
    #[error("stopped before all breaths were run")]
    Stopped,
}

/// A ventilator that the host can run, with controllers of the type `C`: those of a device, or any that run in this process.
pub trait Source<C = Controller> {
    /// Control period, microseconds.
    fn period_us(&self) -> u32;

    /// Name of its plant.
    fn plant(&self) -> String;

    /// The plant's parameters as TOML; empty if unknown.
    fn plant_parameters(&self) -> String;

    /// Selects controller and exploration from the next breath on.
    ///
    /// # Errors
    /// A source that cannot be reached or cannot run the controller.
    fn configure(&mut self, controller: C, exploration: Option<Exploration>) -> Result<(), SourceError>;

    /// Adds a sweep of sines to the commands from the next breath on, in place of the exploration; none ends it.
    ///
    /// # Errors
    /// A source that cannot be reached or refuses the sweep.
    fn sweep(&mut self, sweep: Option<SineSweep>) -> Result<(), SourceError>;

    /// Announces the settings of the next breaths. A source with its own clock must know them before the current breath
    /// ends.
    ///
    /// # Errors
    /// A source that cannot be reached.
    fn upcoming(&mut self, settings: &[Settings]) -> Result<(), SourceError> {
        let _ = settings;
        Ok(())
    }

    /// Runs one whole breath with these settings and passes each tick to `sink`.
    ///
    /// # Errors
    /// Refused settings or a fault of the ventilator; the sink has received the ticks up to then.
    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError>;

    /// What the source has not done of what it was asked, in words; a recording of it keeps them.
    fn shortfalls(&self) -> Vec<String> {
        Vec::new()
    }

    /// After a fault: waits until the pressure has returned to PEEP, then acknowledges.
    ///
    /// # Errors
    /// A source that cannot be reached.
    fn acknowledge(&mut self) -> Result<(), SourceError>;
}

/// A source whose plant can be reset to rest.
pub trait Reseed<C = Controller>: Source<C> {
    /// Makes the plant start from rest with this noise seed before the next breath.
    fn reseed(&mut self, seed: u64);
}
