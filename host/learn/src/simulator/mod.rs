//! Learned simulators: differentiable models that predict the next pressures from past commands.
//!
//! A simulator advances in *blocks* of control ticks. In a block it outputs the pressure at a few *points* (the block's
//! middle and end, or only its end); pressures in between are interpolated. Its inputs are commands averaged over the
//! *parts* of past blocks, kept in a [`CommandLog`]. Blocks of 10 ms fit within the dead time of valve and tube: a
//! command given in a block has no effect before the next block, so one network step covers ten control ticks.
//!
//! [`state_space`] (one plant) and [`hybrid`] (many lungs with known nominal R and C) are ours; [`stitched`] is the
//! architecture of Suo et al. 2021. All implement `Dynamics`. All users of a simulator (its own fit, the training of a
//! controller, an agent) run it through a [`rollout::Rollout`], which dispatches between architectures.

mod breath_start;
mod command_log;
pub mod episode;
mod first_order;
pub mod fit;
pub mod hybrid;
pub(crate) mod leaky;
pub mod model;
pub mod open_loop;
pub(crate) mod recurrent;
pub mod rollout;
pub mod shape;
pub mod shard;
pub mod state_space;
pub mod stitched;
#[cfg(test)]
mod tests_support;
mod timing;
pub mod unit;

pub(crate) use breath_start::USUAL_PEEP;
pub use breath_start::{BreathStart, Members, USUAL_LUNG};
pub use command_log::CommandLog;
pub use first_order::first_order;
pub use timing::Timing;

use std::any::Any;
use std::fmt::Debug;

use crate::layers::{piece, piece_mut};
use engine::Lane;

/// Pressure scaled to zero, and pressure difference scaled to one, inside a simulator, cmH2O.
pub const PRESSURE_SCALE: (f32, f32) = (20.0, 10.0);
/// Command scaled to one inside a simulator, percent.
pub const COMMAND_SCALE: f32 = 50.0;

/// A differentiable architecture with its parameters, run on the lanes of one shard.
trait Dynamics: Debug + Send + Sync {
    /// Values of the forward pass that the backward pass needs.
    type Tape: Send + Sync + 'static;

    /// Memory for a rollout of `blocks` blocks.
    fn tape(&self, blocks: usize) -> Self::Tape;

    /// Starts a breath.
    fn begin(&self, tape: &mut Self::Tape, start: &BreathStart);

    /// Predicts the pressure at the points of a block, cmH2O.
    fn step(&self, tape: &mut Self::Tape, block: usize, log: &CommandLog, points: &mut [Lane]);

    /// Backward pass of [`Self::step`], blocks in reverse order: takes the gradient with respect to the points and adds
    /// that with respect to the commands.
    fn step_back(&self, tape: &mut Self::Tape, block: usize, d_points: &[Lane], d_log: &mut CommandLog);

    /// Starts the next block from this measured pressure (cmH2O) instead of the prediction, in architectures trained
    /// this way (teacher forcing); no gradient then flows between blocks.
    fn teach(&self, _tape: &mut Self::Tape, _block: usize, _measured: &Lane) {}

    /// Adds the gradient with respect to the parameters of the whole rollout, after the last step back.
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

/// The tape of any architecture.
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
