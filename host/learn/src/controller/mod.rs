//! Training the residual controller by back-propagation through learned simulators.
//!
//! From the bottom up: the chip's arithmetic over lanes with gradients (`limit`, `pid`, `features`, [`network`]), the
//! [`loss`], the closed loop of all of them with a simulator ([`rollout`]), the [`scenario`]s of its breaths and
//! the `efforts` in them, the `training` on them, and the resulting file ([`learned`]).

pub mod config;
mod efforts;
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
pub use efforts::EffortConfig;
pub use training::{Checkpoint, CurvePoint, PlantModels, Trained, Training};
