//! Recordings of a ventilator: what was asked, what was commanded, what was measured, tick by tick.
//!
//! [`Recording`] is the one table that every later step reads. [`Recording::save`] and [`Recording::load`] keep it as
//! Parquet with its [`crate::provenance::Provenance`], [`RecordingWriter`] writes one that is longer than memory.
//! [`crate::import`] makes them from tables measured elsewhere.

mod checksum;
mod columns;
mod error;
mod parquet_file;
pub mod quality;
mod table;
#[cfg(test)]
mod tests;
mod writer;

pub use columns::Extra;
pub use error::DatasetError;
pub use parquet_file::PROVENANCE_KEY;
pub use table::{EXPIRATION, FALL, INSPIRATION, Recording, Row, range};
pub use writer::RecordingWriter;
