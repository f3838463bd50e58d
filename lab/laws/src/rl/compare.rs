//! Trains either algorithm on learned simulators with a budget of samples, for comparison with our training.
//!
//! A sample is one control tick of one inspiration on a simulator, as in our training, so that the curves can be
//! compared. At regular intervals the policy, without exploration, is scored on a held-out simulator; the best one is
//! kept.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};
use shared::control::residual::ResidualError;

use super::dqn::{Dqn, DqnConfig};
use super::policy::Policy;
use super::ppo::{Ppo, PpoConfig};
use super::ventilation::{Inspirations, TaskConfig};
use super::{Actions, End, Greedy, Learner, TaskBatch};
use engine::{LANES, Lane};
use learn::simulator::model::Simulator;
use progress::{Progress, Stage};

/// Reinforcement learning: rounds.
pub const REINFORCE: Stage = Stage("train by rewards");

/// Reinforcement learning algorithm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Algorithm {
    /// Proximal policy optimisation on continuous commands.
    Ppo,
    /// Deep Q-learning on levels of the command.
    Dqn,
}

impl Algorithm {
    /// Name for output.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ppo => "PPO",
            Self::Dqn => "DQN",
        }
    }
}

/// Configuration of a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RlConfig {
    /// Settings of PPO.
    pub ppo: PpoConfig,
    /// Task for PPO.
    pub ppo_task: TaskConfig,
    /// Settings of DQN.
    pub dqn: DqnConfig,
    /// Task for DQN.
    pub dqn_task: TaskConfig,
    /// Samples for PPO.
    pub ppo_samples: u64,
    /// Samples for DQN.
    pub dqn_samples: u64,
    /// Number of validations during a training.
    pub validations: u64,
    /// Seed of weights, waveforms, noise and exploration.
    pub seed: u64,
}

impl Default for RlConfig {
    /// The best settings found by hand at R 20 C 20, with budgets of about three minutes on one core each. PPO gains
    /// from holding actions for 5 ms rather than 10 ms, DQN from larger rewards.
    fn default() -> Self {
        Self {
            ppo: PpoConfig::default(),
            ppo_task: TaskConfig { hold_time: 0.005, ..TaskConfig::default() },
            dqn: DqnConfig::default(),
            dqn_task: TaskConfig { reward_scale: 0.5, ..TaskConfig::default() },
            ppo_samples: 20_000_000,
            dqn_samples: 12_000_000,
            validations: 60,
            seed: 0,
        }
    }
}

/// Result of a training.
#[derive(Clone, Debug)]
pub struct TrainedPolicy {
    /// The best policy found.
    pub policy: Policy,
    /// Its score on the held-out simulator, cmH2O.
    pub validation: f64,
    /// Samples consumed, and the score on the held-out simulator at that point, cmH2O.
    pub curve: Vec<(u64, f64)>,
}

/// Trains on `simulators` and validates on `held_out`. The result does not depend on the number of threads; a stopped
/// training returns its best policy so far.
///
/// # Errors
/// Features or gains out of range.
///
/// # Panics
/// See [`Inspirations::new`].
pub fn train(
    algorithm: Algorithm,
    simulators: &[Simulator],
    held_out: &Simulator,
    config: &RlConfig,
    progress: &Progress<'_>,
) -> Result<TrainedPolicy, ResidualError> {
    let (task_config, actions, samples) = match algorithm {
        Algorithm::Ppo => (&config.ppo_task, Actions::Continuous, config.ppo_samples),
        Algorithm::Dqn => (&config.dqn_task, Actions::Discrete(config.dqn_task.levels), config.dqn_samples),
    };
    let task = Inspirations::new(simulators, task_config, actions)?;
    let mut examiner = Inspirations::new(std::slice::from_ref(held_out), task_config, actions)?;
    let perception = task.perception().clone();
    let mut learner: Box<dyn Learner> = match algorithm {
        Algorithm::Ppo => Box::new(Ppo::new(config.ppo.clone(), task, config.seed)),
        Algorithm::Dqn => Box::new(Dqn::new(config.dqn.clone(), task, config.seed)),
    };
    let mut best = (validate(&mut examiner, &learner.greedy(), task_config, config.seed), learner.greedy());
    let mut curve = vec![(0, best.0)];
    let per_round = learner.steps_per_round() as u64 * u64::from(perception.hold);
    let rounds = samples.div_ceil(per_round);
    let every = (rounds / config.validations.max(1)).max(1);
    let task = progress.task(REINFORCE, rounds as usize);
    for round in 0..rounds {
        if task.stopped() {
            break;
        }
        learner.round(round as f32 / rounds as f32);
        if (round + 1) % every == 0 || round + 1 == rounds {
            let greedy = learner.greedy();
            let score = validate(&mut examiner, &greedy, task_config, config.seed);
            curve.push(((round + 1) * per_round, score));
            if score < best.0 {
                best = (score, greedy);
            }
            task.reach((round + 1) as usize);
        }
    }
    let (validation, greedy) = best;
    Ok(TrainedPolicy { policy: Policy { greedy, perception }, validation, curve })
}

/// Number of the random stream for validation.
const VALIDATION_STREAM: u64 = u64::MAX;

/// Mean score over the waveforms, always under the same noise, cmH2O.
fn validate(task: &mut Inspirations, greedy: &Greedy, config: &TaskConfig, seed: u64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(VALIDATION_STREAM);
    let pips = &config.pips;
    task.begin(Lane::from_fn(|l| pips[l % pips.len()]), &mut rng);
    let (mut act, mut seen) = (greedy.actor(), vec![Lane::ZERO; task.observations()]);
    loop {
        task.observe(&mut seen);
        if task.step(&act(&seen))[0].end != End::Not {
            break;
        }
    }
    let scores = task.scores();
    let of = |pip: usize| {
        let own = (0..LANES).filter(|l| l % pips.len() == pip);
        let (sum, count) = own.fold((0.0, 0.0), |(sum, count), l| (sum + f64::from(scores[l]), count + 1.0));
        sum / count
    };
    let waveforms = pips.len().min(LANES);
    (0..waveforms).map(of).sum::<f64>() / waveforms as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use learn::simulator::first_order;
    use std::sync::LazyLock;
    use std::sync::atomic::AtomicBool;

    fn small() -> RlConfig {
        RlConfig {
            ppo_samples: 130_000,
            dqn_samples: 200_000,
            validations: 4,
            ppo: PpoConfig { horizon: 100, minibatch: 256, ..PpoConfig::default() },
            ppo_task: TaskConfig::default(),
            dqn: DqnConfig { warm_up: 320, batch: 64, updates: 4, ..DqnConfig::default() },
            dqn_task: TaskConfig::default(),
            ..RlConfig::default()
        }
    }

    /// Trained once for all tests that use it.
    fn trained(algorithm: Algorithm) -> &'static TrainedPolicy {
        static PPO: LazyLock<TrainedPolicy> =
            LazyLock::new(|| run(Algorithm::Ppo, &small(), &Progress::silent()));
        static DQN: LazyLock<TrainedPolicy> =
            LazyLock::new(|| run(Algorithm::Dqn, &small(), &Progress::silent()));
        if algorithm == Algorithm::Ppo { &PPO } else { &DQN }
    }

    fn run(algorithm: Algorithm, config: &RlConfig, progress: &Progress<'_>) -> TrainedPolicy {
        train(algorithm, &[first_order(1.0)], &first_order(1.0), config, progress).unwrap()
    }

    #[test]
    fn both_learn_and_keep_their_best_policy() {
        for algorithm in [Algorithm::Ppo, Algorithm::Dqn] {
            let trained = trained(algorithm);
            let best = trained.curve.iter().map(|(_, score)| *score).fold(f64::INFINITY, f64::min);
            assert!((trained.validation - best).abs() < f64::EPSILON, "{algorithm:?}");
            assert!(best < 0.5 * trained.curve[0].1, "{algorithm:?}: {:?}", trained.curve);
        }
    }

    #[test]
    fn samples_are_control_ticks_and_cover_the_budget() {
        for (algorithm, per_round) in [(Algorithm::Ppo, 16_000), (Algorithm::Dqn, 160)] {
            let curve = &trained(algorithm).curve;
            let budget = if algorithm == Algorithm::Ppo { small().ppo_samples } else { small().dqn_samples };
            let (last, _) = curve[curve.len() - 1];
            assert!((budget..budget + per_round).contains(&last), "{algorithm:?}: {last}");
            assert!(curve.iter().all(|(samples, _)| samples % per_round == 0));
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_curve() {
        for algorithm in [Algorithm::Ppo, Algorithm::Dqn] {
            let curve = |seed| run(algorithm, &RlConfig { seed, ..small() }, &Progress::silent()).curve;
            let first = &trained(algorithm).curve;
            assert_eq!(curve(small().seed), *first);
            assert_ne!(curve(small().seed + 1), *first);
        }
    }

    #[test]
    fn a_stopped_training_ends_at_once_with_what_it_has() {
        let stop = AtomicBool::new(true);
        let trained = run(Algorithm::Ppo, &small(), &Progress::quiet(&stop));
        assert_eq!(trained.curve.len(), 1);
    }

    #[test]
    fn a_configuration_reads_what_it_wrote() {
        let json = serde_json::to_string(&RlConfig::default()).unwrap();
        assert_eq!(serde_json::from_str::<RlConfig>(&json).unwrap(), RlConfig::default());
    }
}
