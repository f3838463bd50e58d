//! Reinforcement learning for comparison, as in the paper: PPO and DQN on the learned simulators.
//!
//! Both algorithms treat a simulator as a black box: they try commands and receive the error of the pressure as a
//! reward. Our training ([`learn::controller`]) differentiates the same simulator instead.
//!
//! All random numbers come from a seeded `ChaCha8`, and everything runs on the calling thread, so the same seed gives
//! the same policy whatever the number of threads.

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

/// The actions that an agent can choose in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actions {
    /// Any number; the task limits it where necessary.
    Continuous,
    /// One of this number of choices, given by its index.
    Discrete(usize),
}

/// Whether and why an episode ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum End {
    /// The episode continues.
    #[default]
    Not,
    /// A terminal state: no further reward is possible.
    Terminal,
    /// The episode was cut off; its last state still has a value.
    TimeLimit,
}

/// Result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Transition {
    /// Reward.
    pub reward: f32,
    /// Whether the episode ended; if so, a reset must follow.
    pub end: End,
}

/// [`LANES`] copies of a task in lockstep, as simulators and networks compute them.
pub trait TaskBatch {
    /// Length of an observation.
    fn observations(&self) -> usize;

    /// The actions that an agent can choose.
    fn actions(&self) -> Actions;

    /// Starts an episode in the copies whose last one ended.
    fn reset(&mut self, ended: &[bool; LANES], rng: &mut ChaCha8Rng);

    /// Performs one action in every copy.
    fn step(&mut self, actions: &Lane) -> [Transition; LANES];

    /// Writes the agents' observations, [`Self::observations`] lanes; after the end of an episode, its last state.
    fn observe(&self, observation: &mut [Lane]);
}

/// An algorithm with its task.
pub trait Learner {
    /// Collects and learns; `progress` is the completed share of the training, for learning rates and random choices.
    fn round(&mut self, progress: f32);

    /// Steps of the task per round, all copies together.
    fn steps_per_round(&self) -> usize;

    /// The present policy.
    fn greedy(&self) -> Greedy;
}

/// A policy without exploration: the mean of a Gaussian, or the most probable or most valuable choice.
#[derive(Clone, Debug, PartialEq)]
pub struct Greedy {
    /// Shape of the network.
    pub network: Mlp,
    /// Its parameters.
    pub parameters: Vec<f32>,
    /// Meaning of its outputs.
    pub actions: Actions,
}

impl Greedy {
    /// A function from observations to actions, for repeated use.
    pub fn actor(&self) -> impl FnMut(&[Lane]) -> Lane + use<> {
        let (mut network, actions) = (self.network.single(&self.parameters), self.actions);
        move |observation| best(actions, network.outputs(observation))
    }
}

/// The best action by the network's outputs.
fn best(actions: Actions, outputs: &[Lane]) -> Lane {
    match actions {
        Actions::Continuous => outputs[0],
        Actions::Discrete(_) => Lane::from_fn(|l| highest(outputs, l) as f32),
    }
}

/// Index of one copy's highest output; the first among equals.
fn highest(outputs: &[Lane], l: usize) -> usize {
    let better = |best: usize, n: usize| if outputs[n][l] > outputs[best][l] { n } else { best };
    (1..outputs.len()).fold(0, better)
}
