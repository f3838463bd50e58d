//! Everything that is kept in files: recordings, tables measured elsewhere, tensors, and where each came from.
#![forbid(unsafe_code)]

pub mod files;
pub mod identity;
pub mod import;
pub mod provenance;
pub mod recording;
pub mod tensors;
