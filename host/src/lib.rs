//! The learning side of Eupnea: virtual bench, data, learned simulator, controller training, evaluation.
#![forbid(unsafe_code)]

pub mod bench;
pub mod engine;
pub mod dataset;
pub mod files;
pub mod provenance;
