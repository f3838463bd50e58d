//! Everything that both sides of Eupnea compile: the breath, the controllers, the safety filter, the
//! ventilator's state machine, exploration, the weights image and the link.
//!
//! Rules of this crate: no clock, no input or output, no allocation, no panic on any input. Configuration is
//! `&self`, state is a separate value, and a step is a pure function of both, so the chip, the virtual bench
//! and every test run the same code and get the same bits. No function of the platform's float library is
//! called; what is needed stands in [`math`].
//!
//! Units are in names and documentation: pressure cmH2O, time seconds or ticks of the control period, valve
//! commands percent of full opening (0..=100).
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod breath;
pub mod checksum;
pub mod control;
pub mod device;
pub mod explore;
pub mod link;
pub mod math;
pub mod recorder;
pub mod reset;
pub mod safety;
pub mod sensor;
pub mod settings;
pub mod timing;
pub mod ventilator;
pub mod weights;
