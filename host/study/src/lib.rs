//! Whole studies: [`demo`] on one lung, and a [`farm`] of several ventilators.
#![forbid(unsafe_code)]

pub mod demo;
mod error;
pub mod farm;

pub use error::{Result, StudyError};
