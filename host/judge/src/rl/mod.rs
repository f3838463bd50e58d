//! Reinforcement learning, the rival that the paper names: PPO and DQN on the learned simulators.
//!
//! Both algorithms see a simulator from outside only: they try commands and are told how far the pressure strayed
//! from its target. Our training ([`learn::controller`]) differentiates the same simulator instead.
//!
//! Everything is drawn from a seeded `ChaCha8` and runs on the calling thread, so that the same seed gives the same
//! policy whatever the number of threads.

pub mod compare;
pub mod dqn;
pub mod head;
pub mod network;
pub mod policy;
pub mod ppo;
#[cfg(test)]
mod tests;
pub mod ventilation;

use engine::{LANES, Lane};
use network::Mlp;
use rand_chacha::ChaCha8Rng;

/// What an agent may do in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actions {
    /// Any number; a task limits it where it must.
    Continuous,
    /// One of so many choices, given by its index.
    Discrete(usize),
}

/// Whether and why an episode ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum End {
    /// It goes on.
    #[default]
    Not,
    /// Nothing can be gained or lost any more.
    Terminal,
    /// It was cut; the state it was cut in still has a value.
    TimeLimit,
}

/// What a step gave.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Transition {
    /// Reward.
    pub reward: f32,
    /// Whether the episode ended; if so, a reset must follow.
    pub end: End,
}

/// [`LANES`] copies of a task in step, as simulators and networks compute them.
pub trait TaskBatch {
    /// Length of an observation.
    fn observations(&self) -> usize;

    /// What an agent may do.
    fn actions(&self) -> Actions;

    /// Starts an episode in the copies whose last one ended.
    fn reset(&mut self, ended: &[bool; LANES], rng: &mut ChaCha8Rng);

    /// Does one action in every copy.
    fn step(&mut self, actions: &Lane) -> [Transition; LANES];

    /// Writes what the agents see, [`Self::observations`] lanes; after the end of an episode its last state.
    fn observe(&self, observation: &mut [Lane]);
}

/// An algorithm on its task.
pub trait Learner {
    /// Collects and learns; `progress` is the share of the training done, for learning rates and random choices.
    fn round(&mut self, progress: f32);

    /// Steps of the task per round, all copies together.
    fn steps_per_round(&self) -> usize;

    /// The policy as it is now.
    fn greedy(&self) -> Greedy;
}

/// A policy without exploration: the mean of a Gaussian, the most probable or most valuable choice.
#[derive(Clone, Debug, PartialEq)]
pub struct Greedy {
    /// Shape of the network.
    pub network: Mlp,
    /// Its parameters.
    pub parameters: Vec<f32>,
    /// What its outputs stand for.
    pub actions: Actions,
}

impl Greedy {
    /// Actions for observations, ready to be asked again and again.
    pub fn actor(&self) -> impl FnMut(&[Lane]) -> Lane + use<> {
        let (mut network, actions) = (self.network.single(&self.parameters), self.actions);
        move |observation| best(actions, network.outputs(observation))
    }
}

/// The action that a network's outputs speak for most.
fn best(actions: Actions, outputs: &[Lane]) -> Lane {
    match actions {
        Actions::Continuous => outputs[0],
        Actions::Discrete(_) => Lane::from_fn(|l| highest(outputs, l) as f32),
    }
}

/// Index of one copy's highest output, the first of equals.
fn highest(outputs: &[Lane], l: usize) -> usize {
    let better = |best: usize, n: usize| if outputs[n][l] > outputs[best][l] { n } else { best };
    (1..outputs.len()).fold(0, better)
}
