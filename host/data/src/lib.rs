//! Files and their origin: recordings, third-party tables, and tensors.
#![forbid(unsafe_code)]

pub mod files;
pub mod identity;
pub mod import;
pub mod provenance;
pub mod recording;
pub mod tensors;
