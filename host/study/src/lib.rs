//! Whole studies: [`demo`] on one lung, and a [`farm`] of several ventilators; figures of a
//! [`prediction`].
#![forbid(unsafe_code)]

pub mod demo;
mod error;
pub mod farm;
pub mod prediction;

pub use error::{Result, StudyError};
