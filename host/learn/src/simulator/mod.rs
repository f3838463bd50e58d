//! Learned simulators: differentiable models that predict the next pressures from past commands.
//!
//! A simulator advances in *blocks* of control ticks. In a block it outputs the pressure at a few *points* (the block's
//! middle and end, or only its end); pressures in between are interpolated. Its inputs are commands averaged over the
//! *parts* of past blocks, kept in a [`CommandLog`]. Blocks of 10 ms fit within the dead time of valve and tube: a
//! command given in a block has no effect before the next block, so one network step covers ten control ticks.
//!
//! [`state_space`] (one plant) and [`hybrid`] (many lungs with known nominal R and C) are ours; [`stitched`] is the
//! architecture of Suo et al. 2021, and [`mod@unit`] the physical model of a family. What they have in common is in [`design`].
//! All users of a simulator (its own fit, the training of a controller, an agent) run it through a [`rollout::Rollout`].

pub(crate) mod block;
mod branch;
mod breath_start;
mod command_log;
pub mod design;
pub mod episode;
mod first_order;
pub mod fit;
pub(crate) mod fit_config;
pub mod hybrid;
mod leaky;
pub mod model;
pub mod open_loop;
mod recurrent;
pub mod rollout;
pub mod shape;
pub mod shard;
pub mod state_space;
pub mod stitched;
#[cfg(test)]
mod tests_support;
mod timing;
mod trajectory;
pub mod unit;

pub(crate) use breath_start::USUAL_PEEP;
pub use breath_start::{BreathStart, Members, USUAL_LUNG};
pub use command_log::CommandLog;
pub use first_order::first_order;
pub use timing::Timing;

use crate::layers::{piece, piece_mut};

/// Pressure scaled to zero, and pressure difference scaled to one, inside a simulator, cmH2O.
pub const PRESSURE_SCALE: (f32, f32) = (20.0, 10.0);
/// Command scaled to one inside a simulator, percent.
pub const COMMAND_SCALE: f32 = 50.0;
