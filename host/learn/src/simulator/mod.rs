//! Learned simulators: differentiable models that predict the next pressures from past commands.
//!
//! A simulator goes forward in *blocks* of control ticks. In a block it gives the pressure at a few *points*
//! (the block's middle and end, or its end alone); pressures in between are interpolated. Commands reach it as
//! means over the *parts* of past blocks, kept in a [`CommandLog`]. Blocks of 10 ms hide within the dead time
//! of valve and tube: what is commanded in a block cannot be felt before the next one, so one network step
//! serves ten control ticks.
//!
//! [`state_space`] and [`hybrid`] are ours, one for one plant, one for many lungs whose nominal R and C are known;
//! [`stitched`] is the architecture of Suo et al. 2021. All implement `Dynamics`; whatever runs a simulator (its own
//! fit, a controller in training, an agent) does so through a [`rollout::Rollout`], which alone tells them apart.

mod breath_start;
mod command_log;
pub mod episode;
mod first_order;
pub mod fit;
pub mod hybrid;
mod leaky;
pub mod model;
pub mod open_loop;
mod recurrent;
pub mod rollout;
pub mod shard;
pub mod state_space;
pub mod stitched;
#[cfg(test)]
mod tests_support;
mod timing;

pub use breath_start::{BreathStart, Members, USUAL_LUNG};
pub use command_log::CommandLog;
pub use first_order::first_order;
pub use timing::Timing;

use std::any::Any;
use std::fmt::Debug;

use crate::layers::{piece, piece_mut};
use engine::Lane;

/// Pressure that counts as zero, and the distance that counts as one, inside of a simulator, cmH2O.
pub const PRESSURE_SCALE: (f32, f32) = (20.0, 10.0);
/// Command that counts as one inside of a simulator, percent.
pub const COMMAND_SCALE: f32 = 50.0;

/// A differentiable architecture with its parameters, run on the lanes of one shard.
trait Dynamics: Debug + Send + Sync {
    /// What the forward pass leaves behind for the backward pass.
    type Tape: Send + Sync + 'static;

    /// Memory for a rollout of so many blocks.
    fn tape(&self, blocks: usize) -> Self::Tape;

    /// Starts a breath.
    fn begin(&self, tape: &mut Self::Tape, start: &BreathStart);

    /// Predicts the pressure at the points of a block, cmH2O.
    fn step(&self, tape: &mut Self::Tape, block: usize, log: &CommandLog, points: &mut [Lane]);

    /// The gradient of what [`Self::step`] did, blocks in reverse order: takes the gradient by the points, adds
    /// the gradient by the commands.
    fn step_back(&self, tape: &mut Self::Tape, block: usize, d_points: &[Lane], d_log: &mut CommandLog);

    /// Starts the next block from this measured pressure (cmH2O) and not from the prediction, where an architecture is
    /// trained so (teacher forcing); no gradient then flows from block to block.
    fn teach(&self, _tape: &mut Self::Tape, _block: usize, _measured: &Lane) {}

    /// Adds the gradient by the parameters of the whole rollout, after the last step back.
    fn finish(&self, tape: &mut Self::Tape, gradient: &mut [f32]);
}

/// [`Dynamics`] of an architecture that is known only at run time.
trait AnyDynamics: Debug + Send + Sync {
    fn tape(&self, blocks: usize) -> AnyTape;
    fn begin(&self, tape: &mut AnyTape, start: &BreathStart);
    fn step(&self, tape: &mut AnyTape, block: usize, log: &CommandLog, points: &mut [Lane]);
    fn step_back(&self, tape: &mut AnyTape, block: usize, d_points: &[Lane], d_log: &mut CommandLog);
    fn teach(&self, tape: &mut AnyTape, block: usize, measured: &Lane);
    fn finish(&self, tape: &mut AnyTape, gradient: &mut [f32]);
}

/// The tape of some architecture.
type AnyTape = Box<dyn Any + Send + Sync>;

fn own<T: 'static>(tape: &mut AnyTape) -> &mut T {
    tape.downcast_mut().expect("a tape is used by the architecture that made it")
}

impl<M: Dynamics> AnyDynamics for M {
    fn tape(&self, blocks: usize) -> AnyTape {
        Box::new(Dynamics::tape(self, blocks))
    }

    fn begin(&self, tape: &mut AnyTape, start: &BreathStart) {
        Dynamics::begin(self, own(tape), start);
    }

    fn step(&self, tape: &mut AnyTape, block: usize, log: &CommandLog, points: &mut [Lane]) {
        Dynamics::step(self, own(tape), block, log, points);
    }

    fn step_back(&self, tape: &mut AnyTape, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        Dynamics::step_back(self, own(tape), block, d_points, d_log);
    }

    fn teach(&self, tape: &mut AnyTape, block: usize, measured: &Lane) {
        Dynamics::teach(self, own(tape), block, measured);
    }

    fn finish(&self, tape: &mut AnyTape, gradient: &mut [f32]) {
        Dynamics::finish(self, own(tape), gradient);
    }
}
