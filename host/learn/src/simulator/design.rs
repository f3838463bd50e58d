//! What an architecture of simulators provides. A new one is a file that implements [`Design`] for its shape and
//! [`Dynamics`] for its equations, and a line in [`Architecture`](super::model::Architecture).

use std::fmt::Debug;
use std::ops::Range;

use rand_chacha::ChaCha8Rng;

use super::block::Block;
use super::episode::Episode;
use super::fit_config::{BATCH, FitConfig, STEPS};
use super::shape::ShapeError;
use super::{BreathStart, CommandLog, Timing};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use data::recording::Recording;
use engine::Lane;

/// An architecture in one shape.
pub trait Design: Debug {
    /// Division of time into blocks.
    fn timing(&self) -> &Timing;

    /// Number of parameters.
    fn parameters(&self) -> usize;

    /// Checks that a simulator of this shape can be built: each of its numbers is within its bounds.
    ///
    /// # Errors
    /// The first number that is not.
    fn check(&self) -> Result<(), ShapeError>;

    /// Draws initial parameters.
    fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32>;

    /// A model with these parameters, and memory for a rollout of `blocks` blocks.
    fn dynamics(&self, parameters: &[f32], blocks: usize) -> Box<dyn Dynamics>;

    /// One block as a graph: the pressure after each of its ticks, and the state after it.
    fn graph(&self, graph: &mut Builder, block: &Block, parameters: &[f32]) -> (Value, State);

    /// Number of units that a breath can name as its ventilator; 1 for a model of one plant.
    fn members(&self) -> usize {
        1
    }

    /// Whether it is a model of many lungs.
    fn many_lungs(&self) -> bool {
        false
    }

    /// Default configuration of a fit, and the number of gradient steps after which it gains little; without one, the
    /// configuration's epochs count.
    fn fitting(&self) -> (FitConfig, Option<usize>) {
        (FitConfig { batch: BATCH, ..FitConfig::default() }, Some(STEPS))
    }

    /// Parameters that a fit trains together, each with the share of the epochs in which it does.
    fn groups(&self) -> Vec<(Range<usize>, f32)> {
        vec![(0..self.parameters(), 1.0)]
    }

    /// The episodes to fit, from the training episodes of a recording.
    fn lessons(&self, _recording: &Recording, training: &[&Episode]) -> Vec<Episode> {
        training.iter().map(|episode| (*episode).clone()).collect()
    }
}

/// A differentiable model with its parameters and the memory of a rollout, on the lanes of one shard.
pub trait Dynamics: Debug + Send + Sync {
    /// Replaces the parameters.
    fn load(&mut self, parameters: &[f32]);

    /// Starts a breath.
    fn begin(&mut self, start: &BreathStart);

    /// Predicts the pressure at the points of a block, cmH2O.
    fn step(&mut self, block: usize, log: &CommandLog, points: &mut [Lane]);

    /// Backward pass of [`Self::step`], blocks in reverse order: takes the gradient with respect to the points and adds
    /// that with respect to the commands.
    fn step_back(&mut self, block: usize, d_points: &[Lane], d_log: &mut CommandLog);

    /// Starts the next block from this measured pressure (cmH2O) instead of the prediction, in architectures trained
    /// this way (teacher forcing); no gradient then flows between blocks.
    fn teach(&mut self, _block: usize, _measured: &Lane) {}

    /// Adds the gradient with respect to the parameters of the whole rollout, after the last step back.
    fn finish(&self, gradient: &mut [f32]);
}
