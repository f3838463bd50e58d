//! Reinforcement learning, the rival that the paper names: PPO and DQN on the learned simulators.
//!
//! Both algorithms see a simulator from outside only: they try commands and are told how far the pressure strayed
//! from its target. Our training ([`learn::controller`]) differentiates the same simulator instead.
//!
//! | file | what |
//! |---|---|
//! | [`network`] | multilayer perceptron with gradient |
//! | [`head`] | what a policy's outputs mean: Gaussian or categorical distribution |
//! | [`ppo`], [`dqn`] | the two algorithms, for any [`VectorEnvironment`] |
//! | [`cart_pole`] | a task with known difficulty, which proves them correct |
//! | [`ventilation`] | the inspiration as a task |
//! | [`policy`] | what was learned, as commands of the valve; its file; its score on the true bench |
//! | [`compare`] | training of either on learned simulators under a budget |
//!
//! Everything is drawn from a seeded `ChaCha8` and runs on the calling thread, so that the same seed gives the same
//! policy whatever the number of threads.

pub mod cart_pole;
pub mod compare;
pub mod dqn;
pub mod head;
pub mod network;
pub mod policy;
pub mod ppo;
pub mod ventilation;

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use engine::{LANES, Lane};
use network::{Mlp, MlpTape};

/// What an agent may do in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
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

/// One task, one episode at a time.
pub trait Environment {
    /// Length of an observation.
    fn observations(&self) -> usize;

    /// What an agent may do.
    fn actions(&self) -> Actions;

    /// Starts an episode.
    fn reset(&mut self, rng: &mut ChaCha8Rng);

    /// Does an action: a number, or the index of a choice.
    fn step(&mut self, action: f32) -> Transition;

    /// Writes what the agent sees, [`Self::observations`] numbers.
    fn observe(&self, observation: &mut [f32]);
}

/// [`LANES`] copies of a task in step, as simulators and networks compute them.
pub trait VectorEnvironment {
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

/// Independent copies of an environment side by side.
#[derive(Clone, Debug)]
pub struct Copies<E>([E; LANES]);

impl<E: Environment + Clone> Copies<E> {
    /// Copies of `environment`.
    pub fn of(environment: &E) -> Self {
        Self(std::array::from_fn(|_| environment.clone()))
    }
}

impl<E: Environment> VectorEnvironment for Copies<E> {
    fn observations(&self) -> usize {
        self.0[0].observations()
    }

    fn actions(&self) -> Actions {
        self.0[0].actions()
    }

    fn reset(&mut self, ended: &[bool; LANES], rng: &mut ChaCha8Rng) {
        for (copy, _) in self.0.iter_mut().zip(ended).filter(|(_, ended)| **ended) {
            copy.reset(rng);
        }
    }

    fn step(&mut self, actions: &Lane) -> [Transition; LANES] {
        std::array::from_fn(|l| self.0[l].step(actions[l]))
    }

    fn observe(&self, observation: &mut [Lane]) {
        let mut own = vec![0.0; observation.len()];
        for (l, copy) in self.0.iter().enumerate() {
            copy.observe(&mut own);
            for (lane, value) in observation.iter_mut().zip(&own) {
                lane[l] = *value;
            }
        }
    }
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
        let weights = self.network.load(&self.parameters);
        let (mut tape, actions) = (MlpTape::new(&self.network, 1), self.actions);
        move |observation| {
            tape.inputs(0).copy_from_slice(observation);
            weights.forward(&mut tape);
            best(actions, tape.outputs(0))
        }
    }

    /// Mean return of so many whole episodes (rounded up to whole shards), each copy's first ones.
    pub fn mean_return(
        &self,
        environment: &mut impl VectorEnvironment,
        episodes: usize,
        rng: &mut ChaCha8Rng,
    ) -> f64 {
        let mut act = self.actor();
        let each = episodes.div_ceil(LANES);
        let (mut done, mut total) = ([0; LANES], 0.0);
        let mut seen = vec![Lane::ZERO; environment.observations()];
        environment.reset(&[true; LANES], rng);
        while done.iter().any(|done| *done < each) {
            environment.observe(&mut seen);
            let transitions = environment.step(&act(&seen));
            for (done, transition) in done.iter_mut().zip(&transitions).filter(|(done, _)| **done < each) {
                total += f64::from(transition.reward);
                *done += usize::from(transition.end != End::Not);
            }
            environment.reset(&transitions.map(|transition| transition.end != End::Not), rng);
        }
        total / (each * LANES) as f64
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

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    /// Counts down from its number; the reward is the action.
    #[derive(Clone, Debug)]
    struct Countdown(u32);

    impl Environment for Countdown {
        fn observations(&self) -> usize {
            1
        }

        fn actions(&self) -> Actions {
            Actions::Discrete(3)
        }

        fn reset(&mut self, _: &mut ChaCha8Rng) {
            self.0 = 5;
        }

        fn step(&mut self, action: f32) -> Transition {
            self.0 -= 1;
            Transition { reward: action, end: if self.0 == 0 { End::Terminal } else { End::Not } }
        }

        fn observe(&self, observation: &mut [f32]) {
            observation[0] = self.0 as f32;
        }
    }

    #[test]
    fn copies_are_reset_one_by_one() {
        let mut copies = Copies::of(&Countdown(7));
        copies.reset(&std::array::from_fn(|l| l == 3), &mut ChaCha8Rng::seed_from_u64(0));
        let mut seen = [Lane::ZERO];
        copies.observe(&mut seen);
        assert_eq!(seen[0], Lane::from_fn(|l| if l == 3 { 5.0 } else { 7.0 }));
    }

    #[test]
    fn a_mean_return_is_that_of_whole_episodes() {
        // The network's outputs are its biases: the last choice is the best, and its index the reward.
        let network = Mlp::new(&[1, 3]);
        let parameters = vec![0.0, 0.0, 0.0, -1.0, 0.5, 2.0];
        let greedy = Greedy { network, parameters, actions: Actions::Discrete(3) };
        let mut copies = Copies::of(&Countdown(1));
        let mean = greedy.mean_return(&mut copies, 20, &mut ChaCha8Rng::seed_from_u64(0));
        assert!((mean - 10.0).abs() < 1e-9, "five steps of reward 2, not {mean}");
    }
}
