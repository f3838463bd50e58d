//! Training the residual controller by back-propagation through learned simulators.
//!
//! From the bottom up: what the chip computes, over lanes and with gradients (`limit`, `pid`, `features`,
//! [`network`]), the [`loss`], the closed loop of all of them with a simulator ([`rollout`]), the [`scenario`]s that it
//! breathes, the `training` on them, and what comes of it as a file ([`learned`]).

pub mod config;
mod features;
pub mod learned;
mod limit;
pub mod loss;
pub mod network;
mod pid;
pub mod rollout;
pub mod scenario;
mod training;

pub use config::{TrainConfig, Weighting};
pub use training::{Checkpoint, CurvePoint, PlantModels, Trained, Training};
