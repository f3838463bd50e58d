//! The code that host and chip share: the breath, the controllers, the safety filter, the ventilator's state
//! machine, exploration, the weights image and the link.
//!
//! Rules of this crate: no clock, no input or output, no allocation, no panic on any input. Configuration is
//! `&self`, state is a separate value, and a step is a pure function of both, so the chip, the virtual bench
//! and every test run the same code and get the same bits. The platform's float library is never called: [`math`]
//! defines the functions that the crate needs.
//!
//! Every state machine asserts its invariants with `debug_assert!`: no input may violate them. Tests, fuzz targets
//! and debug builds run with them. The profiles `release`, `chip`, `wheel` and `web` compile them out: nothing may
//! panic on the chip, and a tick there has a budget.
//!
//! Names and documentation give the units: pressure in cmH2O, time in seconds or in ticks of the control period,
//! valve commands in percent of full opening (0..=100).
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod breath;
pub mod calibration;
pub mod checksum;
pub mod control;
pub mod device;
pub mod explore;
pub mod flash;
pub mod link;
pub mod math;
pub mod recorder;
pub mod reset;
pub mod safety;
pub mod sensor;
pub mod settings;
pub mod timing;
pub mod trigger;
pub mod ventilator;
pub mod weights;
