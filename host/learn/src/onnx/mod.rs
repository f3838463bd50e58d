//! Export to ONNX, the open format of neural networks: learned controllers and simulators as graphs that any runtime can run.
//!
//! A graph is one step: inputs and the state in, outputs and the next state out, for any number of rows at a time. [`controller`] and
//! [`authors()`] are one control tick of a learned controller, [`simulator()`] is one block of a learned simulator. [`mod@check`] writes what
//! this program computes, so that a runtime's results can be compared. `docs/FILES.md` describes inputs and outputs.

mod authors;
pub mod check;
pub mod controller;
mod memory;
pub mod simulator;
#[cfg(test)]
mod tests;

pub use authors::authors;
pub use controller::residual;
pub use simulator::{OnnxError, simulator};
