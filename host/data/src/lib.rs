//! Files and their origin: recordings, third-party tables, exports, tensors, and the folders of runs.
#![forbid(unsafe_code)]

pub mod difference;
pub mod export;
pub mod files;
pub mod identity;
pub mod import;
pub mod kind;
pub mod pirds;
pub mod provenance;
pub mod recording;
pub mod tensors;
pub mod workspace;
