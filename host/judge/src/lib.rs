//! Judging: how well any controller does, what there is to beat, and what happens when something breaks.
#![forbid(unsafe_code)]

pub mod balloon;
pub mod baselines;
pub mod bound;
pub mod evaluate;
pub mod faults;
pub mod identify;
pub mod rl;
pub mod simulator;
