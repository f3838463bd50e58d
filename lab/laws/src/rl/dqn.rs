//! Deep Q-learning (Mnih et al. 2015) with double targets (van Hasselt et al. 2016).
//!
//! The network estimates the value of every choice. Its target is the reward plus the discounted value of the next
//! state, where the network picks the choice and a slowly updated copy values it. Samples are drawn at random from a
//! replay buffer; a share of the choices, which falls during training, is random too.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};

use super::network::{Mlp, MlpTape};
use super::{Actions, End, Greedy, Learner, TaskBatch, Transition, best, highest};
use engine::adam::{Adam, AdamConfig};
use engine::{LANES, Lane};

/// Settings of the algorithm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DqnConfig {
    /// Units of the hidden layers.
    pub hidden: Vec<usize>,
    /// Capacity of the replay buffer, in transitions.
    pub capacity: usize,
    /// Transitions before the first gradient step.
    pub warm_up: usize,
    /// Samples per gradient step (rounded up to whole groups).
    pub batch: usize,
    /// Gradient steps per environment step of all copies.
    pub updates: usize,
    /// Gradient steps between updates of the target network.
    pub target_every: usize,
    /// Discount per step.
    pub discount: f32,
    /// Share of random choices at the start and at the end.
    pub epsilon: (f32, f32),
    /// Share of the training over which the share of random choices falls.
    pub epsilon_time: f32,
    /// Error of a value above which the loss grows linearly (Huber).
    pub huber: f32,
    /// Optimiser; clips the gradient's norm.
    pub adam: AdamConfig,
}

impl Default for DqnConfig {
    /// The best settings found by hand for the inspirations of [`super::ventilation`] at R 20 C 20.
    fn default() -> Self {
        Self {
            hidden: vec![128, 64],
            capacity: 100_000,
            warm_up: 16_000,
            batch: 128,
            updates: 2,
            target_every: 100,
            discount: 0.95,
            epsilon: (1.0, 0.05),
            epsilon_time: 0.3,
            huber: 10.0,
            adam: AdamConfig { rate: 1e-3, final_share: 0.02, weight_decay: 0.0, clip: 10.0 },
        }
    }
}

/// A running training.
#[derive(Debug)]
pub struct Dqn<S> {
    config: DqnConfig,
    tasks: S,
    network: Mlp,
    choices: usize,
    parameters: Vec<f32>,
    target: Vec<f32>,
    adam: Adam,
    replay: Replay,
    seen: Vec<Lane>,
    updates: usize,
    rng: ChaCha8Rng,
}

/// A ring buffer of the last transitions.
#[derive(Debug)]
struct Replay {
    width: usize,
    capacity: usize,
    /// State and next state of each transition, one after the other.
    states: Vec<f32>,
    facts: Vec<Fact>,
    next: usize,
}

/// A transition between two states.
#[derive(Clone, Copy, Debug)]
struct Fact {
    choice: usize,
    reward: f32,
    /// Whether the next state has a value.
    goes_on: bool,
}

impl<S: TaskBatch> Dqn<S> {
    /// Prepares a training on `tasks`.
    ///
    /// # Panics
    /// If the actions are continuous.
    pub fn new(config: DqnConfig, mut tasks: S, seed: u64) -> Self {
        let Actions::Discrete(choices) = tasks.actions() else {
            panic!("Q-learning needs a finite number of choices");
        };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let network = Mlp::with_hidden(tasks.observations(), &config.hidden, choices);
        let parameters = network.initialise(1.0, &mut rng);
        tasks.reset(&[true; LANES], &mut rng);
        let mut seen = vec![Lane::ZERO; tasks.observations()];
        tasks.observe(&mut seen);
        Self {
            adam: Adam::new(config.adam, parameters.len()),
            replay: Replay::new(tasks.observations(), config.capacity),
            target: parameters.clone(),
            config,
            tasks,
            network,
            choices,
            parameters,
            seen,
            updates: 0,
            rng,
        }
    }

    fn choose(&mut self, progress: f32) -> Lane {
        let mut network = self.network.single(&self.parameters);
        let greedy = best(Actions::Discrete(self.choices), network.outputs(&self.seen));
        let epsilon = epsilon(&self.config, progress);
        greedy.map(|choice| {
            let explores = self.rng.random::<f32>() < epsilon;
            if explores { self.rng.random_range(0..self.choices) as f32 } else { choice }
        })
    }

    /// One gradient step.
    fn improve(&mut self, progress: f32) {
        let groups = self.config.batch.div_ceil(LANES).max(1);
        let samples: Vec<usize> =
            (0..groups * LANES).map(|_| self.rng.random_range(0..self.replay.facts.len())).collect();
        let wanted = self.targets(&samples);
        let weights = self.network.load(&self.parameters);
        let mut tape = MlpTape::new(&self.network, groups);
        self.replay.gather(&samples, State::Before, &mut tape);
        weights.forward(&mut tape);
        let share = 1.0 / samples.len() as f32;
        for (group, (samples, wanted)) in samples.chunks_exact(LANES).zip(&wanted).enumerate() {
            let outputs = tape.outputs(group).to_vec();
            let d = tape.d_outputs(group);
            d.fill(Lane::ZERO);
            for (l, sample) in samples.iter().enumerate() {
                let choice = self.replay.facts[*sample].choice;
                let error = outputs[choice][l] - wanted[l];
                d[choice][l] = share * error.clamp(-self.config.huber, self.config.huber);
            }
        }
        let mut gradient = vec![0.0; self.parameters.len()];
        weights.backward(&mut tape, &mut gradient);
        self.adam.step(&mut self.parameters, &gradient, progress);
        self.updates += 1;
        if self.updates.is_multiple_of(self.config.target_every.max(1)) {
            self.target.clone_from(&self.parameters);
        }
    }

    /// Target values of the samples' choices.
    fn targets(&self, samples: &[usize]) -> Vec<Lane> {
        let mut tape = MlpTape::new(&self.network, samples.len() / LANES);
        self.replay.gather(samples, State::After, &mut tape);
        let mut slow = tape.clone();
        self.network.load(&self.parameters).forward(&mut tape);
        self.network.load(&self.target).forward(&mut slow);
        let of = |group: usize, l: usize, sample: usize| {
            let Fact { reward, goes_on, .. } = self.replay.facts[sample];
            let picked = highest(tape.outputs(group), l);
            let rest = self.config.discount * slow.outputs(group)[picked][l];
            if goes_on { reward + rest } else { reward }
        };
        let groups = samples.chunks_exact(LANES).enumerate();
        groups.map(|(group, samples)| Lane::from_fn(|l| of(group, l, samples[l]))).collect()
    }
}

impl<S: TaskBatch> Learner for Dqn<S> {
    /// One step in every copy, then the gradient steps that belong to it.
    fn round(&mut self, progress: f32) {
        let actions = self.choose(progress);
        let transitions = self.tasks.step(&actions);
        let before = self.seen.clone();
        self.tasks.observe(&mut self.seen);
        self.replay.record(&before, &actions, &transitions, &self.seen);
        let ended = transitions.map(|transition| transition.end != End::Not);
        if ended.contains(&true) {
            self.tasks.reset(&ended, &mut self.rng);
            self.tasks.observe(&mut self.seen);
        }
        if self.replay.facts.len() >= self.config.warm_up.max(LANES) {
            (0..self.config.updates).for_each(|_| self.improve(progress));
        }
    }

    fn steps_per_round(&self) -> usize {
        LANES
    }

    fn greedy(&self) -> Greedy {
        let (network, parameters) = (self.network.clone(), self.parameters.clone());
        Greedy { network, parameters, actions: Actions::Discrete(self.choices) }
    }
}

/// Share of random choices.
fn epsilon(config: &DqnConfig, progress: f32) -> f32 {
    let (first, last) = config.epsilon;
    let done = (progress / config.epsilon_time.max(f32::EPSILON)).min(1.0);
    first + (last - first) * done
}

/// Selects a state of a transition.
#[derive(Clone, Copy)]
enum State {
    Before,
    After,
}

impl Replay {
    fn new(width: usize, capacity: usize) -> Self {
        Self { width, capacity: capacity.max(LANES), states: Vec::new(), facts: Vec::new(), next: 0 }
    }

    /// Stores one transition of every copy, in place of the oldest ones once the buffer is full.
    fn record(&mut self, before: &[Lane], actions: &Lane, transitions: &[Transition; LANES], after: &[Lane]) {
        for (l, Transition { reward, end }) in transitions.iter().enumerate() {
            let fact = Fact { choice: actions[l] as usize, reward: *reward, goes_on: *end != End::Terminal };
            let states = before.iter().chain(after).map(|lane| lane[l]);
            if self.facts.len() < self.capacity {
                self.facts.push(fact);
                self.states.extend(states);
            } else {
                self.facts[self.next] = fact;
                let place = self.next * 2 * self.width;
                for (kept, value) in self.states[place..].iter_mut().zip(states) {
                    *kept = value;
                }
            }
            self.next = (self.next + 1) % self.capacity;
        }
    }

    fn gather(&self, samples: &[usize], state: State, tape: &mut MlpTape) {
        for (group, samples) in samples.chunks_exact(LANES).enumerate() {
            let inputs = tape.inputs(group);
            for (l, sample) in samples.iter().enumerate() {
                let place = (2 * sample + state as usize) * self.width;
                for (lane, value) in inputs.iter_mut().zip(&self.states[place..]) {
                    lane[l] = *value;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::tests::cart_pole::CartPole;
    use crate::rl::tests::{Copies, mean_return};

    /// One hidden layer: with two the pole stays up, but the cart drifts off its track. The discount looks far enough
    /// ahead, and the target is updated often enough for values to propagate that far.
    fn cart_pole() -> DqnConfig {
        DqnConfig {
            hidden: vec![128],
            warm_up: 2_000,
            batch: 64,
            updates: 4,
            target_every: 50,
            discount: 0.99,
            epsilon: (1.0, 0.1),
            epsilon_time: 0.6,
            ..DqnConfig::default()
        }
    }

    fn trained(rounds: usize, of: usize, seed: u64) -> Greedy {
        let mut dqn = Dqn::new(cart_pole(), Copies::of(&CartPole::default()), seed);
        (0..rounds).for_each(|round| dqn.round(round as f32 / of as f32));
        dqn.greedy()
    }

    #[test]
    fn cart_pole_is_solved() {
        let greedy = trained(5000, 5000, 1);
        let mut rng = ChaCha8Rng::seed_from_u64(999);
        let mean = mean_return(&greedy, &mut Copies::of(&CartPole::default()), 100, &mut rng);
        assert!(mean >= 475.0, "mean return {mean}");
    }

    #[test]
    fn the_same_seed_gives_the_same_policy() {
        assert_eq!(trained(150, 6000, 4), trained(150, 6000, 4));
        assert_ne!(trained(150, 6000, 4), trained(150, 6000, 5));
    }

    #[test]
    fn random_choices_become_fewer_and_stay_few() {
        let config = DqnConfig { epsilon: (1.0, 0.1), epsilon_time: 0.5, ..DqnConfig::default() };
        let at = |progress| (epsilon(&config, progress) * 100.0).round() as i32;
        assert_eq!([0.0, 0.25, 0.5, 1.0].map(at), [100, 55, 10, 10]);
    }

    fn step(reward: f32, end: End) -> [Transition; LANES] {
        [Transition { reward, end }; LANES]
    }

    #[test]
    fn a_full_buffer_forgets_the_oldest() {
        let mut replay = Replay::new(1, 2 * LANES);
        for n in 0..3_u8 {
            let (before, after) = (Lane::splat(f32::from(n)), Lane::splat(f32::from(n) + 0.5));
            replay.record(&[before], &Lane::splat(1.0), &step(f32::from(n), End::Not), &[after]);
        }
        assert_eq!(replay.facts.len(), 2 * LANES);
        let mut tape = MlpTape::new(&Mlp::new(&[1, 1]), 2);
        let all: Vec<usize> = (0..2 * LANES).collect();
        replay.gather(&all, State::After, &mut tape);
        let (newest, older) = (tape.inputs(0)[0], tape.inputs(1)[0]);
        assert_eq!((newest, older), (Lane::splat(2.5), Lane::splat(1.5)));
        assert!((replay.facts[0].reward - 2.0).abs() < f32::EPSILON);
    }

    #[test]
    fn the_network_picks_and_its_slow_copy_values() {
        let config = DqnConfig { hidden: vec![], discount: 0.5, ..DqnConfig::default() };
        let mut dqn = Dqn::new(config, Copies::of(&CartPole::default()), 0);
        // Both networks output their biases: the fast one prefers the second choice, the slow one the first.
        dqn.parameters = [vec![0.0; 8], vec![1.0, 2.0]].concat();
        dqn.target = [vec![0.0; 8], vec![40.0, 30.0]].concat();
        let state = [Lane::ZERO; 4];
        for end in [End::Not, End::TimeLimit, End::Terminal] {
            dqn.replay.record(&state, &Lane::ZERO, &step(1.0, end), &state);
        }
        let samples: Vec<usize> = (0..3 * LANES).collect();
        let targets: Vec<f32> = dqn.targets(&samples).iter().map(|lane| lane[0]).collect();
        assert_eq!(targets, [16.0, 16.0, 1.0], "only what is truly over has no rest");
    }
}
