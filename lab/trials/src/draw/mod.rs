//! Drawn faults: cases from everything that is allowed, judged by what the bench knows.
//!
//! A [`case`] is a machine, a patient, a prescription, a controller and up to three faults, all of it drawn by a [`generator`] from a
//! seed and a number, and written as TOML that repeats it. It runs on the device as on the chip ([`run`]) and is held to four promises
//! ([`promise`]). A case that breaks one is made as small as it can be ([`shrink`]). What cases need of the supervisor is found by leaving
//! out one part of it after the other ([`needs`]).

pub mod case;
pub mod generator;
pub mod names;
pub mod needs;
pub mod promise;
pub mod run;
pub mod shrink;
pub mod tally;
#[cfg(test)]
mod tests;
