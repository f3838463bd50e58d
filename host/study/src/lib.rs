//! Whole studies: [`demo`] on one lung, [`reproduce`] for the paper's experiments, [`sweep`] over options of a command, [`farm`] of
//! several ventilators; and the [`runs`] that studies leave.
#![forbid(unsafe_code)]

pub mod demo;
mod error;
pub mod farm;
pub mod reproduce;
pub mod runs;
pub mod sweep;

pub use error::StudyError;
