//! Where samples come from: one trait for the ventilator in this process, on any plant, and for devices at a port.
//!
//! A [`Source`] is a whole *ventilator*: it takes settings and a controller and breathes by its own clock. What
//! it does reaches the host as one sample per control tick.

#![forbid(unsafe_code)]

pub mod collect;
mod in_process;
mod port;
pub mod seeds;
#[cfg(all(test, unix))]
mod tests;
#[cfg(unix)]
mod virtual_board;

pub use in_process::{BalloonSource, BenchSource, InProcess, PlantSource, SharedLink};
pub use port::PortSource;

use shared::control::Controller;
use shared::explore::Exploration;
use shared::safety::alarms::Fault;
use shared::settings::{Settings, SettingsError};
use shared::ventilator::Sample;
use thiserror::Error;

use device::DeviceError;
use device::upload::UploadError;
use plant::TickTruth;
use plant::bench::BenchError;
use plant::link::PlantError;

/// How long a fault's vented lung rests before the next breath, s.
const REST_TIME: f32 = 3.0;

/// One control tick as the host sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// What the ventilator reports.
    pub sample: Sample,
    /// What the plant knows, if it is a bench.
    pub truth: Option<TickTruth>,
}

/// Why a source stopped giving samples.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The ventilator went to its safe state.
    #[error(
        "the ventilator went to its safe state ({fault:?}) in breath {breath} at tick {tick}; check lung, limit and controller"
    )]
    Fault {
        /// Why.
        fault: Fault,
        /// Breath in which it happened.
        breath: u32,
        /// Tick of that breath.
        tick: u32,
    },
    /// Settings were refused.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The bench cannot be built or run.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The device.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The plant behind the plant link.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The virtual board.
    #[cfg(unix)]
    #[error(transparent)]
    Emulator(#[from] emulator::EmulatorError),
    /// The device does not take the weights.
    #[error(transparent)]
    Upload(#[from] UploadError),
    /// Samples are missing.
    #[error(
        "samples are missing on the line at breath {breath}, tick {tick}; the recording up to there is sound: try a shorter cable or another port"
    )]
    Lost {
        /// Breath of the first missing sample.
        breath: u32,
        /// Its tick.
        tick: u32,
    },
    /// The device sends nothing more.
    #[error("the device stopped sending samples in breath {breath}; look at it with `trainer identify`")]
    Silent {
        /// Breath that was running.
        breath: u32,
    },
    /// Ctrl-C.
    #[error("stopped before all breaths were run")]
    Stopped,
}

/// A ventilator that can be run from here.
pub trait Source {
    /// Control period, microseconds.
    fn period_us(&self) -> u32;

    /// Name of the plant behind it.
    fn plant(&self) -> String;

    /// The plant's parameters as TOML, empty where they are unknown.
    fn plant_parameters(&self) -> String;

    /// Chooses controller and exploration; the next breath starts with them.
    ///
    /// # Errors
    /// A source that cannot be reached or cannot run the controller.
    fn configure(
        &mut self,
        controller: Controller,
        exploration: Option<Exploration>,
    ) -> Result<(), SourceError>;

    /// What the next breaths will be asked to run. A source that breathes by a clock of its own has to know before a
    /// breath ends what comes after it.
    ///
    /// # Errors
    /// A source that cannot be reached.
    fn upcoming(&mut self, settings: &[Settings]) -> Result<(), SourceError> {
        let _ = settings;
        Ok(())
    }

    /// Runs one whole breath with these settings and hands each tick to `sink`.
    ///
    /// # Errors
    /// Refused settings or a fault of the ventilator; ticks up to then have reached the sink.
    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError>;

    /// After a fault: waits until the pressure is back at PEEP and acknowledges.
    ///
    /// # Errors
    /// A source that cannot be reached.
    fn acknowledge(&mut self) -> Result<(), SourceError>;
}

/// A source whose plant can be brought back to rest.
pub trait Reseed: Source {
    /// The plant starts from rest with this seed for its noise before the next breath.
    fn reseed(&mut self, seed: u64);
}
