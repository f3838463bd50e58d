//! Learning: simulators from recordings, controllers through simulators, and the pipeline that does both in rounds.
#![forbid(unsafe_code)]

pub mod c_export;
pub mod controller;
mod graph;
mod layers;
pub mod onnx;
pub mod pipeline;
pub mod recipe;
pub mod simulator;
#[cfg(test)]
mod tests_support;
