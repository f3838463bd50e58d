//! Plants: the ventilator's hardware and the lung, simulated or remote.
//!
//! A [`Plant`] is a lung with valves, circuit and sensor. [`mod@bench`] is the virtual bench, [`balloon`] the plant of the
//! paper's authors, [`link`] a plant in another process, reached over a [`line`](mod@line). [`mod@prescriptions`] are what plants are
//! ventilated with.
#![forbid(unsafe_code)]

pub mod balloon;
pub mod bench;
pub mod line;
pub mod link;
pub mod prescriptions;
pub mod range;

pub use ::bench::TickTruth;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A lung with valves, circuit and sensor, driven one control period at a time.
pub trait Plant {
    /// The error of a plant that cannot run.
    type Error: std::error::Error;

    /// The plant's name, for recordings.
    fn name(&self) -> String;

    /// The plant's parameters as TOML; empty if unknown.
    fn parameters(&self) -> String {
        String::new()
    }

    /// Brings it to rest at `peep` cmH2O, with valves in the safe state, control periods of `period_us` microseconds
    /// and this seed for its random numbers. From here on, the same commands give the same readings.
    ///
    /// # Errors
    /// A control period or PEEP that it cannot run, or a plant that cannot be reached.
    fn reset(&mut self, period_us: u32, seed: u64, peep: f32) -> Result<Reading, Self::Error>;

    /// Turns the mechanical PEEP valve to `peep` cmH2O; no time passes.
    ///
    /// # Errors
    /// A plant that cannot be reached.
    fn set_peep(&mut self, peep: f32) -> Result<(), Self::Error>;

    /// Runs one control period with the inspiratory valve at `u_in` percent and the expiratory valve open if `u_out`;
    /// returns the reading at its end.
    ///
    /// # Errors
    /// A plant that cannot be reached.
    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, Self::Error>;
}

/// The sensors of a plant at one instant. NaN marks a sensor that the plant does not have; readings without that
/// sensor can be equal.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Airway pressure as measured by the sensor, cmH2O.
    pub pressure: f32,
    /// Pressure at the machine's outlet as measured by a second sensor, cmH2O.
    pub outlet: f32,
    /// Flow at the airway opening as measured by a sensor, L/s; positive towards the patient.
    pub flow: f32,
    /// The true state, if the plant reports it; no controller sees it.
    pub truth: Option<TickTruth>,
}

impl PartialEq for Reading {
    fn eq(&self, other: &Self) -> bool {
        let bits = |reading: &Self| [reading.pressure, reading.outlet, reading.flow].map(f32::to_bits);
        bits(self) == bits(other) && self.truth == other.truth
    }
}

impl Reading {
    /// The reading of a plant that has only the sensor of the airway pressure and does not report its state.
    pub const fn of_pressure(pressure: f32) -> Self {
        Self { pressure, outlet: f32::NAN, flow: f32::NAN, truth: None }
    }
}

/// A plant shared by several ventilators, used one after the other.
impl<P: Plant> Plant for Arc<Mutex<P>> {
    type Error = P::Error;

    fn name(&self) -> String {
        locked(self).name()
    }

    fn parameters(&self) -> String {
        locked(self).parameters()
    }

    fn reset(&mut self, period_us: u32, seed: u64, peep: f32) -> Result<Reading, P::Error> {
        locked(self).reset(period_us, seed, peep)
    }

    fn set_peep(&mut self, peep: f32) -> Result<(), P::Error> {
        locked(self).set_peep(peep)
    }

    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, P::Error> {
        locked(self).step(u_in, u_out)
    }
}

/// Locks data that every user leaves in a valid state, so that a panic elsewhere does no harm.
pub fn locked<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
