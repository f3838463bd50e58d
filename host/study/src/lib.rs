//! Whole studies: [`demo`] on one lung, [`reproduce`] for the paper's experiments, [`sweep`] over options of a command.
#![forbid(unsafe_code)]

pub mod demo;
mod error;
pub mod reproduce;
pub mod sweep;

pub use error::StudyError;
