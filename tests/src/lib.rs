//! What the whole-system tests in `tests/tests` share: a plant whose results are the same on every machine, and the
//! trace of a ventilator that runs on it.
#![forbid(unsafe_code)]

pub mod exact_lung;
pub mod trace;
