//! What stands in for the ventilator's hardware and the lung.
//!
//! [`bench`] is the virtual bench, [`balloon`] the plant of the paper's authors, [`link`] a plant in another process.
#![forbid(unsafe_code)]

pub mod balloon;
pub mod bench;
pub mod link;
mod truth;

pub use truth::TickTruth;
