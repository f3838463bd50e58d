//! The gradient engine: forward and backward passes over batches. Those of layers are written by hand;
//! equations are written once over a [`Number`](number::Number), and a [`Tape`](tape::Tape) gives their
//! gradients.
//!
//! A batch is divided into *shards* of [`LANES`] rollouts. Within a shard all data is a structure of arrays: one
//! [`Lane`] contains one quantity of all its rollouts, so every operation is a vector operation. Shards are independent
//! and are reduced in their order, so results do not depend on the number of threads.

#![forbid(unsafe_code)]

pub mod activation;
pub mod adam;
pub mod dense;
pub mod huber;
pub mod lane;
pub mod least_squares;
pub mod number;
pub mod power;
pub mod tape;

pub use lane::{LANES, Lane};
