//! The learning side of Eupnea: virtual bench, data, learned simulator, controller training, evaluation.
#![forbid(unsafe_code)]

pub mod balloon;
pub mod baselines;
pub mod bench;
pub mod blackbox;
pub mod bound;
pub mod cli;
pub mod collect;
pub mod dataset;
pub mod demo;
pub mod device;
#[cfg(unix)]
pub mod emulator;
pub mod engine;
pub mod evaluate;
pub mod faults;
pub mod files;
pub mod identify;
pub mod monitor;
pub mod pipeline;
pub mod plant;
pub mod port;
pub mod provenance;
pub mod report;
pub mod reproduce;
pub mod rl;
pub mod simulator;
pub mod source;
pub mod tensors;
pub mod train;
pub mod watch;
