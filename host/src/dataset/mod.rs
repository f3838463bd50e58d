//! Recordings of a ventilator: what was asked, what was commanded, what was measured, tick by tick.
//!
//! [`Recording`] is the one table that every later step reads. [`Recording::save`] and [`Recording::load`] keep it as
//! Parquet with its [`crate::provenance::Provenance`]; [`respiraworks`] makes one from tables measured elsewhere.

mod checksum;
mod columns;
mod error;
mod parquet_file;
mod recording;
pub mod respiraworks;
#[cfg(test)]
mod tests;

pub use columns::Extra;
pub use error::DatasetError;
pub use parquet_file::PROVENANCE_KEY;
pub use recording::{EXPIRATION, FALL, INSPIRATION, Recording, Row};
