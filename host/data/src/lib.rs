//! Files and their origin: recordings, third-party tables, exports, and tensors.
#![forbid(unsafe_code)]

pub mod export;
pub mod files;
pub mod identity;
pub mod import;
pub mod pirds;
pub mod provenance;
pub mod recording;
pub mod tensors;
