//! Recordings of a ventilator: requested, commanded and measured values, tick by tick.
//!
//! [`Recording`] is the one table that all later steps read. [`Recording::save`] and [`Recording::load`] store it as
//! Parquet with its [`crate::provenance::Provenance`]; [`RecordingWriter`] writes one that is larger than memory.
//! [`crate::import`] converts third-party tables.

mod checksum;
mod columns;
mod error;
mod parquet_file;
pub mod quality;
mod table;
#[cfg(test)]
mod tests;
mod writer;

pub use columns::{Extra, Recording, Row};
pub use error::DatasetError;
pub use parquet_file::PROVENANCE_KEY;
pub use table::{EXPIRATION, FALL, INSPIRATION, PHASE_NAMES, numbered_phase, phase_number, range};
pub use writer::RecordingWriter;
