//! Small tasks with known answers that verify the algorithms: single tasks, and copies in a shard.

pub mod cart_pole;

use rand_chacha::rand_core::SeedableRng;

use super::*;

/// A single task with one episode at a time.
pub trait Environment {
    /// Length of an observation.
    fn observations(&self) -> usize;

    /// The actions that an agent can choose.
    fn actions(&self) -> Actions;

    /// Starts an episode.
    fn reset(&mut self, rng: &mut ChaCha8Rng);

    /// Performs an action: a number, or the index of a choice.
    fn step(&mut self, action: f32) -> Transition;

    /// Writes the agent's observation, [`Self::observations`] numbers.
    fn observe(&self, observation: &mut [f32]);
}

/// Independent copies of an environment as a shard.
#[derive(Clone, Debug)]
pub struct Copies<E>([E; LANES]);

impl<E: Environment + Clone> Copies<E> {
    /// Copies of `environment`.
    pub fn of(environment: &E) -> Self {
        Self(std::array::from_fn(|_| environment.clone()))
    }
}

impl<E: Environment> TaskBatch for Copies<E> {
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

/// Mean return of this number of whole episodes (rounded up to whole shards), the first ones of each copy.
pub fn mean_return(
    greedy: &Greedy,
    shard: &mut impl TaskBatch,
    episodes: usize,
    rng: &mut ChaCha8Rng,
) -> f64 {
    let mut act = greedy.actor();
    let each = episodes.div_ceil(LANES);
    let (mut done, mut total) = ([0; LANES], 0.0);
    let mut seen = vec![Lane::ZERO; shard.observations()];
    shard.reset(&[true; LANES], rng);
    while done.iter().any(|done| *done < each) {
        shard.observe(&mut seen);
        let transitions = shard.step(&act(&seen));
        for (done, transition) in done.iter_mut().zip(&transitions).filter(|(done, _)| **done < each) {
            total += f64::from(transition.reward);
            *done += usize::from(transition.end != End::Not);
        }
        shard.reset(&transitions.map(|transition| transition.end != End::Not), rng);
    }
    total / (each * LANES) as f64
}

/// A task that counts down from its number; the reward is the action.
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
    // The network outputs its biases: the last choice is the best, and its index is the reward.
    let network = Mlp::new(&[1, 3]);
    let parameters = vec![0.0, 0.0, 0.0, -1.0, 0.5, 2.0];
    let greedy = Greedy { network, parameters, actions: Actions::Discrete(3) };
    let mut copies = Copies::of(&Countdown(1));
    let mean = mean_return(&greedy, &mut copies, 20, &mut ChaCha8Rng::seed_from_u64(0));
    assert!((mean - 10.0).abs() < 1e-9, "five steps of reward 2, not {mean}");
}
