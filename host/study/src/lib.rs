//! Whole studies: [`demo`] on one lung, [`reproduce`] for the paper's experiments.
#![forbid(unsafe_code)]

pub mod demo;
mod error;
pub mod reproduce;

pub use error::StudyError;
