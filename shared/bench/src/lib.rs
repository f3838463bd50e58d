//! The virtual bench: a simulated ventilator, circuit, test lung and patient.
//!
//! [`BenchConfig`] describes a bench (TOML file or preset), [`Bench`] runs it: one [`Bench::step`] takes the commands
//! for 1 ms and returns the sensor's reading. [`Bench::truth`] shows what no ventilator can see. There is one file per
//! part of the machine; `branch` solves for the pressure where the parts meet.
//!
//! A patient who breathes irregularly and coughs, on a leak that opens after a minute:
//!
//! ```
//! # use bench::{Bench, BenchConfig};
//! let config = BenchConfig::from_toml(
//!     "[patient]
//!      effort_cmh2o = 8.0
//!      effort_variability_percent = 20.0
//!      double_efforts_percent = 5.0
//!      cough_cmh2o = 40.0
//!      coughs_per_hour = 20.0
//!      resistance_growth_percent_per_hour = 3.0
//!      [circuit]
//!      leak_changes = [{ at_s = 60.0, leak_l_per_s_at_30_cmh2o = 0.3 }]
//!      [outlet_sensor]
//!      offset_cmh2o = 0.5
//!      [flow_sensor]
//!      gain_error_percent = -3.0",
//! )?;
//! let mut bench = Bench::new(&config, 5.0, 1)?;
//! let airway = bench.step(20.0, false);
//! let (outlet, flow) = (bench.outlet_reading(), bench.flow_reading());
//! assert!((outlet - airway).abs() < 1.5 && flow.abs() < 0.1);
//! assert_eq!(bench.truth().effort_started_s, Some(0.0));
//! # Ok::<(), bench::BenchError>(())
//! ```
//!
//! It is designed to be as hard to control as a real ventilator, but does not model a particular one: dead time,
//! backlash, dead zone, a curved valve characteristic, sensor noise and unit differences are on by default.

#![cfg_attr(not(feature = "std"), no_std)]
#![forbid(unsafe_code)]

mod bench;
mod blower;
mod branch;
mod characteristic;
mod circuit;
mod config;
mod coughs;
mod delay;
mod drive;
mod expiratory;
mod flow_sensor;
mod lag;
mod lung;
mod math;
mod outlet_sensor;
mod patient;
#[cfg(feature = "std")]
mod presets;
mod pulse;
mod random;
mod sensor;
mod step;
mod storage;
#[cfg(test)]
mod tests;
mod unit;
mod valve;

pub use bench::{Bench, TickTruth, Truth, end_stops, steps_per_period};
#[cfg(feature = "std")]
pub use presets::is_neonatal;
pub use random::share;
pub use step::{LEAST_SUB_STEPS, STEP_S, STEP_US};
pub use storage::{List, MOST_DELAY_MS, MOST_FAULTS, MOST_LEAK_CHANGES, MOST_NAME_BYTES, Text};

pub use config::{
    BenchConfig, BenchError, BlowerConfig, CircuitConfig, CompartmentConfig, Distortion, ExpiratoryConfig,
    Failure, FaultConfig, Faulty, FlowSensorConfig, LeakChange, LungConfig, OutletSensorConfig,
    PEEP_RANGE_CMH2O, PatientConfig, Repeats, SensorConfig, Signal, Strain, UnitConfig, ValveConfig,
};
