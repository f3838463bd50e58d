//! Scores of any controller: evaluation on a plant, baselines, breathing patients, and the reference bound.
#![forbid(unsafe_code)]

pub mod baselines;
pub mod bound;
pub mod breathing;
pub mod evaluate;
