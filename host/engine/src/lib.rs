//! The gradient engine: hand-written forward and backward passes over batches.
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

pub use lane::{LANES, Lane};
