//! Faults on the virtual bench: does the right monitor fire in time, and does the true pressure stay within its bound?

#[cfg(test)]
mod backup_tests;
pub mod cases;
#[cfg(test)]
mod disconnection_tests;
#[cfg(test)]
mod frozen_tests;
pub(crate) mod hostile;
pub mod injection;
#[cfg(test)]
mod latch_tests;
pub mod matrix;
pub mod parts;
pub(crate) mod rig;
pub mod torture;
pub mod trial;
pub(crate) mod volume;
