//! Proximal policy optimisation with a clipped objective (Schulman et al. 2017), advantages by generalised advantage
//! estimation (Schulman et al. 2016).
//!
//! A round collects `horizon` steps in every copy of the task, then improves policy and value network over several
//! epochs of shuffled minibatches. The two networks are separate, so their losses need no relative weight.

use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};

use super::head::{Head, Slope};
use super::network::{Mlp, MlpTape, Single};
use super::{Actions, End, Greedy, Learner, TaskBatch, Transition};
use engine::adam::{Adam, AdamConfig};
use engine::{LANES, Lane};

/// Settings of the algorithm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PpoConfig {
    /// Units of the hidden layers of policy and value network.
    pub hidden: Vec<usize>,
    /// Steps of every copy per round.
    pub horizon: usize,
    /// Passes over the samples of a round.
    pub epochs: usize,
    /// Samples per gradient step (rounded up to whole groups).
    pub minibatch: usize,
    /// Discount per step.
    pub discount: f32,
    /// Decay of the advantage estimate per step.
    pub lambda: f32,
    /// Largest relative change of an action's probability that is still rewarded.
    pub clip: f32,
    /// Weight of the entropy.
    pub entropy: f32,
    /// Divergence from the round's first policy above which its epochs end.
    pub divergence_limit: f32,
    /// Initial logarithm of the standard deviation.
    pub log_sd: f32,
    /// Optimiser of the policy; clips the gradient's norm.
    pub policy: AdamConfig,
    /// Optimiser of the value network.
    pub value: AdamConfig,
}

impl Default for PpoConfig {
    /// The best settings found by hand for the inspirations of [`super::ventilation`] at R 20 C 20.
    fn default() -> Self {
        let adam = AdamConfig { rate: 1e-3, final_share: 0.02, weight_decay: 0.0, clip: 0.5 };
        Self {
            hidden: vec![64, 64],
            horizon: 800,
            epochs: 10,
            minibatch: 1024,
            discount: 0.98,
            lambda: 0.95,
            clip: 0.2,
            entropy: 0.0,
            divergence_limit: 0.03,
            log_sd: -0.5,
            policy: adam,
            value: adam,
        }
    }
}

/// Gain of the policy's output layer at the start: all states give nearly the same action.
const POLICY_GAIN: f32 = 0.01;
/// Keeps the normalisation of equal advantages finite.
const ADVANTAGE_FLOOR: f32 = 1e-6;

/// A running training.
#[derive(Debug)]
pub struct Ppo<S> {
    config: PpoConfig,
    tasks: S,
    actions: Actions,
    policy: Mlp,
    value: Mlp,
    /// Parameters of the policy's network, then the logarithm of the standard deviation.
    policy_parameters: Vec<f32>,
    value_parameters: Vec<f32>,
    policy_adam: Adam,
    value_adam: Adam,
    rollout: RolloutBuffer,
    rng: ChaCha8Rng,
}

/// The samples of a round, step by step.
#[derive(Debug)]
struct RolloutBuffer {
    width: usize,
    observations: Vec<Lane>,
    actions: Vec<Lane>,
    log_probabilities: Vec<Lane>,
    /// Values of each step's state and of the state after the last step.
    values: Vec<Lane>,
    rewards: Vec<Lane>,
    /// One if the episode continued, zero if it ended.
    goes_on: Vec<Lane>,
    advantages: Vec<Lane>,
    returns: Vec<Lane>,
}

impl<S: TaskBatch> Ppo<S> {
    /// Prepares a training on `tasks`.
    pub fn new(config: PpoConfig, mut tasks: S, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (width, actions) = (tasks.observations(), tasks.actions());
        let policy = Mlp::with_hidden(width, &config.hidden, Head::outputs(actions));
        let value = Mlp::with_hidden(width, &config.hidden, 1);
        let mut policy_parameters = policy.initialise(POLICY_GAIN, &mut rng);
        policy_parameters.push(config.log_sd);
        let value_parameters = value.initialise(1.0, &mut rng);
        tasks.reset(&[true; LANES], &mut rng);
        Self {
            policy_adam: Adam::new(config.policy, policy_parameters.len()),
            value_adam: Adam::new(config.value, value_parameters.len()),
            rollout: RolloutBuffer::new(width, config.horizon),
            config,
            tasks,
            actions,
            policy,
            value,
            policy_parameters,
            value_parameters,
            rng,
        }
    }

    fn head(&self) -> Head {
        match self.actions {
            Actions::Continuous => {
                Head::Gaussian { log_sd: self.policy_parameters[self.policy.parameters()] }
            }
            Actions::Discrete(_) => Head::Categorical,
        }
    }

    /// Runs the policy for one horizon.
    fn collect(&mut self) {
        let head = self.head();
        let mut policy = self.policy.single(&self.policy_parameters);
        let mut critic = self.value.single(&self.value_parameters);
        let mut seen = vec![Lane::ZERO; self.rollout.width];
        for step in 0..self.config.horizon {
            self.tasks.observe(&mut seen);
            let outputs = policy.outputs(&seen);
            let actions = head.sample(outputs, &mut self.rng);
            let rollout = &mut self.rollout;
            rollout.observations[step * rollout.width..][..rollout.width].copy_from_slice(&seen);
            rollout.actions[step] = actions;
            rollout.log_probabilities[step] = head.log_probability(outputs, &actions);
            rollout.values[step] = critic.outputs(&seen)[0];
            let transitions = self.tasks.step(&actions);
            let cut = self.value_of_cut(&mut critic, &transitions);
            self.rollout.rewards[step] = Lane::from_fn(|l| transitions[l].reward).zip(&cut, |r, c| r + c);
            let ended = transitions.map(|transition| transition.end != End::Not);
            self.rollout.goes_on[step] = Lane::from_fn(|l| f32::from(u8::from(!ended[l])));
            self.tasks.reset(&ended, &mut self.rng);
        }
        self.tasks.observe(&mut seen);
        self.rollout.values[self.config.horizon] = critic.outputs(&seen)[0];
    }

    /// Discounted value of the remainder of episodes that were cut off.
    fn value_of_cut(&self, critic: &mut Single, transitions: &[Transition; LANES]) -> Lane {
        if transitions.iter().all(|transition| transition.end != End::TimeLimit) {
            return Lane::ZERO;
        }
        let mut last = vec![Lane::ZERO; self.rollout.width];
        self.tasks.observe(&mut last);
        let value = critic.outputs(&last)[0];
        Lane::from_fn(|l| match transitions[l].end {
            End::TimeLimit => self.config.discount * value[l],
            _ => 0.0,
        })
    }

    /// One gradient step of the policy; returns the batch's mean divergence from the policy that collected it.
    fn improve_policy(&mut self, tape: &mut MlpTape, batch: &[usize], progress: f32) -> f32 {
        let (head, size) = (self.head(), self.policy.parameters());
        let weights = self.policy.load(&self.policy_parameters);
        let (mean, scale) = self.rollout.normalisation(batch);
        self.rollout.gather_observations(batch, tape);
        weights.forward(tape);
        let mut gradient = vec![0.0; size + 1];
        let (share, mut divergence) = (1.0 / batch.len() as f32, 0.0);
        for (group, samples) in batch.chunks_exact(LANES).enumerate() {
            let actions = gather(&self.rollout.actions, samples);
            let before = gather(&self.rollout.log_probabilities, samples);
            let advantage = gather(&self.rollout.advantages, samples).map(|a| (a - mean) * scale);
            let outputs = tape.outputs(group).to_vec();
            let change = head.log_probability(&outputs, &actions).zip(&before, |now, before| now - before);
            divergence += change.map(|change| change.exp() - 1.0 - change).sum() * share;
            let slope = Slope {
                log_probability: change
                    .zip(&advantage, |change, a| share * clipped_slope(change.exp(), a, self.config.clip)),
                entropy: -share * self.config.entropy,
            };
            gradient[size] += head.backward(&outputs, &actions, &slope, tape.d_outputs(group));
        }
        weights.backward(tape, &mut gradient);
        self.policy_adam.step(&mut self.policy_parameters, &gradient, progress);
        divergence
    }

    /// One gradient step of the value network: half the mean squared distance from the returns.
    fn improve_value(&mut self, tape: &mut MlpTape, batch: &[usize], progress: f32) {
        let weights = self.value.load(&self.value_parameters);
        self.rollout.gather_observations(batch, tape);
        weights.forward(tape);
        let share = 1.0 / batch.len() as f32;
        for (group, samples) in batch.chunks_exact(LANES).enumerate() {
            let returns = gather(&self.rollout.returns, samples);
            let d = tape.outputs(group)[0].zip(&returns, |value, wanted| share * (value - wanted));
            tape.d_outputs(group)[0] = d;
        }
        let mut gradient = vec![0.0; self.value_parameters.len()];
        weights.backward(tape, &mut gradient);
        self.value_adam.step(&mut self.value_parameters, &gradient, progress);
    }
}

impl<S: TaskBatch> Learner for Ppo<S> {
    fn round(&mut self, progress: f32) {
        self.collect();
        self.rollout.estimate(self.config.discount, self.config.lambda);
        let groups = self.config.minibatch.div_ceil(LANES).min(self.config.horizon).max(1);
        let mut policy_tape = MlpTape::new(&self.policy, groups);
        let mut value_tape = MlpTape::new(&self.value, groups);
        let mut order: Vec<usize> = (0..self.steps_per_round()).collect();
        for _ in 0..self.config.epochs {
            order.shuffle(&mut self.rng);
            let (mut divergence, mut batches) = (0.0, 0);
            for batch in order.chunks_exact(groups * LANES) {
                divergence += self.improve_policy(&mut policy_tape, batch, progress);
                self.improve_value(&mut value_tape, batch, progress);
                batches += 1;
            }
            if divergence > self.config.divergence_limit * batches as f32 {
                break;
            }
        }
    }

    fn steps_per_round(&self) -> usize {
        self.config.horizon * LANES
    }

    fn greedy(&self) -> Greedy {
        let parameters = self.policy_parameters[..self.policy.parameters()].to_vec();
        Greedy { network: self.policy.clone(), parameters, actions: self.actions }
    }
}

/// Derivative of the loss `-min(ratio a, clipped ratio a)` with respect to the logarithm of the ratio.
fn clipped_slope(ratio: f32, advantage: f32, clip: f32) -> f32 {
    let beyond = if advantage > 0.0 { ratio > 1.0 + clip } else { ratio < 1.0 - clip };
    if beyond { 0.0 } else { -ratio * advantage }
}

/// One value per sample; a sample is a step and a copy.
fn gather(values: &[Lane], samples: &[usize]) -> Lane {
    Lane::from_fn(|l| values[samples[l] / LANES][samples[l] % LANES])
}

impl RolloutBuffer {
    fn new(width: usize, horizon: usize) -> Self {
        let zeros = || vec![Lane::ZERO; horizon];
        Self {
            width,
            observations: vec![Lane::ZERO; width * horizon],
            actions: zeros(),
            log_probabilities: zeros(),
            values: vec![Lane::ZERO; horizon + 1],
            rewards: zeros(),
            goes_on: zeros(),
            advantages: zeros(),
            returns: zeros(),
        }
    }

    /// Estimates advantages and returns.
    fn estimate(&mut self, discount: f32, lambda: f32) {
        let mut advantage = Lane::ZERO;
        for step in (0..self.rewards.len()).rev() {
            let (now, next, goes_on) = (&self.values[step], &self.values[step + 1], &self.goes_on[step]);
            advantage = Lane::from_fn(|l| {
                let surprise = self.rewards[step][l] + discount * goes_on[l] * next[l] - now[l];
                surprise + discount * lambda * goes_on[l] * advantage[l]
            });
            self.advantages[step] = advantage;
            self.returns[step] = advantage.zip(now, |advantage, value| advantage + value);
        }
    }

    /// Mean of a batch's advantages and the inverse of their standard deviation.
    fn normalisation(&self, batch: &[usize]) -> (f32, f32) {
        let of = |sample: &usize| self.advantages[sample / LANES][sample % LANES];
        let count = batch.len() as f32;
        let mean = batch.iter().map(of).sum::<f32>() / count;
        let variance = batch.iter().map(|sample| (of(sample) - mean).powi(2)).sum::<f32>() / count;
        (mean, 1.0 / (variance.sqrt() + ADVANTAGE_FLOOR))
    }

    fn gather_observations(&self, batch: &[usize], tape: &mut MlpTape) {
        for (group, samples) in batch.chunks_exact(LANES).enumerate() {
            for (i, lane) in tape.inputs(group).iter_mut().enumerate() {
                *lane = Lane::from_fn(|l| {
                    self.observations[samples[l] / LANES * self.width + i][samples[l] % LANES]
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::tests::cart_pole::CartPole;
    use crate::rl::tests::{Copies, Environment, mean_return};
    use rand_distr::{Distribution, StandardNormal};

    /// A configuration for tasks that need fewer samples per round.
    fn quick() -> PpoConfig {
        PpoConfig { horizon: 64, minibatch: 256, discount: 0.99, ..PpoConfig::default() }
    }

    fn trained(rounds: usize, seed: u64) -> Greedy {
        let mut ppo = Ppo::new(quick(), Copies::of(&CartPole::default()), seed);
        (0..rounds).for_each(|round| ppo.round(round as f32 / rounds as f32));
        ppo.greedy()
    }

    #[test]
    fn cart_pole_is_solved() {
        let greedy = trained(100, 1);
        let mut rng = ChaCha8Rng::seed_from_u64(999);
        let mean = mean_return(&greedy, &mut Copies::of(&CartPole::default()), 100, &mut rng);
        assert!(mean >= 475.0, "mean return {mean}");
    }

    #[test]
    fn the_same_seed_gives_the_same_policy() {
        assert_eq!(trained(2, 4), trained(2, 4));
        assert_ne!(trained(2, 4), trained(2, 5));
    }

    /// A task in which the action must match a given number: the reward is minus the squared distance.
    #[derive(Clone, Debug, Default)]
    struct Follow(f32);

    impl Environment for Follow {
        fn observations(&self) -> usize {
            1
        }

        fn actions(&self) -> Actions {
            Actions::Continuous
        }

        fn reset(&mut self, rng: &mut ChaCha8Rng) {
            self.0 = StandardNormal.sample(rng);
        }

        fn step(&mut self, action: f32) -> Transition {
            Transition { reward: -(action - 0.5 * self.0).powi(2), end: End::Terminal }
        }

        fn observe(&self, observation: &mut [f32]) {
            observation[0] = self.0;
        }
    }

    #[test]
    fn a_continuous_action_is_learned_and_its_spread_shrinks() {
        let config = PpoConfig { horizon: 32, ..quick() };
        let mut ppo = Ppo::new(config, Copies::of(&Follow::default()), 2);
        let spread = |ppo: &Ppo<_>| ppo.policy_parameters[ppo.policy.parameters()].exp();
        let before = spread(&ppo);
        (0..100).for_each(|round| ppo.round(round as f32 / 100.0));
        let mut act = ppo.greedy().actor();
        let shown = Lane::from_fn(|l| 0.2 * l as f32 - 1.6);
        let worst = act(&[shown]).zip(&shown, |a, x| (a - 0.5 * x).abs()).0.into_iter().fold(0.0, f32::max);
        assert!(worst < 0.1, "off by {worst}");
        assert!(spread(&ppo) < 0.5 * before, "{} after {before}", spread(&ppo));
    }

    /// A task of one step with a reward of one and a given kind of end.
    #[derive(Clone, Debug)]
    struct OneStep(End);

    impl Environment for OneStep {
        fn observations(&self) -> usize {
            1
        }

        fn actions(&self) -> Actions {
            Actions::Discrete(2)
        }

        fn reset(&mut self, _: &mut ChaCha8Rng) {}

        fn step(&mut self, _: f32) -> Transition {
            Transition { reward: 1.0, end: self.0 }
        }

        fn observe(&self, observation: &mut [f32]) {
            observation[0] = 1.0;
        }
    }

    #[test]
    fn an_episode_that_was_cut_has_a_future_and_one_that_ended_has_none() {
        // One point per step without end, discounted by half, is two points.
        for (end, worth) in [(End::TimeLimit, 2.0), (End::Terminal, 1.0)] {
            let value = AdamConfig { rate: 1e-2, ..PpoConfig::default().value };
            let config = PpoConfig { discount: 0.5, horizon: 16, value, ..quick() };
            let mut ppo = Ppo::new(config, Copies::of(&OneStep(end)), 1);
            (0..60).for_each(|round| ppo.round(round as f32 / 60.0));
            let learned = ppo.value.single(&ppo.value_parameters).outputs(&[Lane::splat(1.0)])[0][0];
            assert!((learned - worth).abs() < 0.05, "{end:?}: {learned}");
        }
    }

    #[test]
    fn advantages_stop_at_the_end_of_an_episode() {
        let mut rollout = RolloutBuffer::new(1, 3);
        rollout.rewards = vec![Lane::splat(1.0), Lane::splat(2.0), Lane::splat(4.0)];
        rollout.values = [0.5, 0.25, 3.0, 7.0].map(Lane::splat).to_vec();
        rollout.goes_on = vec![Lane::splat(1.0), Lane::ZERO, Lane::splat(1.0)];
        rollout.estimate(0.5, 0.5);
        // 2: 4 + 0.5 * 7 - 3. 1: 2 - 0.25, the end. 0: 1 + 0.5 * 0.25 - 0.5 + 0.25 * 1.75.
        let expected = [1.0625, 1.75, 4.5];
        for (advantage, expected) in rollout.advantages.iter().zip(expected) {
            assert!((advantage[0] - expected).abs() < 1e-6, "{}", advantage[0]);
        }
        assert!((rollout.returns[1][0] - 2.0).abs() < 1e-6);
    }

    #[test]
    fn what_is_beyond_the_clip_is_not_rewarded_but_can_come_back() {
        let slopes = [(1.3, 1.0), (1.3, -1.0), (0.7, 1.0), (0.7, -1.0)]
            .map(|(ratio, advantage)| clipped_slope(ratio, advantage, 0.2));
        assert_eq!(slopes.map(f32::to_bits), [0.0, 1.3, -0.7, 0.0].map(f32::to_bits));
    }

    #[test]
    fn a_sample_is_gathered_with_all_that_belongs_to_it() {
        let mut rollout = RolloutBuffer::new(2, 4);
        for (n, lane) in rollout.observations.iter_mut().enumerate() {
            *lane = Lane::from_fn(|l| (100 * n + l) as f32);
        }
        let batch: Vec<usize> = (0..LANES).map(|n| (n * 13 + 5) % (4 * LANES)).collect();
        let mut tape = MlpTape::new(&Mlp::new(&[2, 1]), 1);
        rollout.gather_observations(&batch, &mut tape);
        for (l, sample) in batch.iter().enumerate() {
            let (step, copy) = (sample / LANES, sample % LANES);
            assert_eq!(tape.inputs(0)[1][l] as usize, 100 * (2 * step + 1) + copy);
        }
    }
}
