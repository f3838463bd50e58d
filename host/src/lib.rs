//! The learning side of Eupnea.
#![forbid(unsafe_code)]

pub mod dataset;
pub mod files;
pub mod provenance;
pub mod report;
