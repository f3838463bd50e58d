//! Where samples come from: one trait for the in-process bench and, later, ports.
//!
//! A [`Source`] is a whole *ventilator*: it takes settings and a controller and breathes by its own clock. What
//! it does reaches the host as one sample per control tick.

mod bench;

pub use bench::BenchSource;

use shared::control::Controller;
use shared::explore::Exploration;
use shared::safety::supervisor::Fault;
use shared::settings::{Settings, SettingsError};
use shared::ventilator::{Sample, Ventilator};
use thiserror::Error;

use crate::bench::BenchError;

/// What only a bench knows of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickTruth {
    /// Pressure at the airway, cmH2O.
    pub airway_pressure: f32,
    /// Pressure behind the sensor's lag, before noise and quantum, cmH2O.
    pub sensor_pressure: f32,
}

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
    /// The bench cannot be built.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The bench steps in milliseconds.
    #[error("the bench runs in steps of 1000 us: a control period of {period_us} us is no multiple of that")]
    Period {
        /// Control period asked for, microseconds.
        period_us: u32,
    },
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
    fn configure(&mut self, controller: Controller, exploration: Option<Exploration>);

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

/// A ventilator's configuration from its parts.
fn ventilator(period_us: u32, controller: Controller, exploration: Option<Exploration>) -> Ventilator {
    Ventilator::new(period_us, controller).with_exploration(exploration)
}
