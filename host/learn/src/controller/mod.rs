//! Training the residual controller by back-propagation through learned simulators.
//!
//! From the bottom up: the chip's arithmetic over lanes with gradients (`limit`, `pid`, `features`, [`network`]), the
//! [`loss`], the closed loop of all of them with a simulator ([`rollout`]), the [`scenario`]s of its breaths and
//! the `efforts` in them, the `training` on them, and the resulting file ([`learned`]). For a [`family`] of units, breaths follow
//! each other: the `courses`, and what they remember ([`memory`]). On `plateaus`, a [`probe`] measures the margins of their loops. An
//! `oracle` can tell what would be gained by knowing the unit. The [`architecture`] of the learned part is ours (`ours`) or that of
//! the paper's [`authors`].

pub mod architecture;
pub mod authors;
pub mod config;
mod courses;
mod efforts;
pub mod family;
mod features;
pub mod learned;
mod limit;
pub mod loss;
pub mod memory;
pub mod network;
mod oracle;
mod ours;
mod pid;
mod plateaus;
pub mod probe;
pub mod rollout;
pub mod scenario;
pub mod shipped;
mod signals;
mod student;
mod tapes;
mod training;

pub use architecture::{ControllerArchitecture, Trainable};
pub use config::{EFFORT_PRICE, FamilyConfig, Told, TrainConfig, Weighting};
pub use efforts::EffortConfig;
pub use family::{FamilyModels, FamilyTraining};
pub use training::{Checkpoint, CurvePoint, PlantModels, Stepwise, Trained, Training};
