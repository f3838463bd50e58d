//! Comparison with reinforcement learning: PPO and DQN on the same learned simulators with the same observations;
//! scores against samples used, beside ours.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use shared::control::Controller;

use super::study::{Piece, Study, piece};
use super::{Reproduction, lungs};
use engine::LANES;
use laws::rl::compare::{Algorithm, RlConfig, train};
use laws::rl::policy::evaluate;
use learn::controller::{PlantModels, TrainConfig, Training};
use learn::pipeline::{self, PipelineConfig};
use learn::simulator::model::Simulator;
use plant::bench::BenchConfig;
use study::{Result, StudyError};

/// Gradient steps between two validations of our training.
const OURS_VALIDATED_EVERY: usize = 10;

/// Result of one learning method.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct LearnerResult {
    /// Score on the true bench, cmH2O.
    pub(super) score: f64,
    /// Simulated control ticks used.
    pub(super) samples: u64,
    /// Ticks used, and the score on the held-out simulator at that point, cmH2O.
    pub(super) curve: Vec<(u64, f64)>,
}

impl LearnerResult {
    /// Ticks used until the score on the held-out simulator was at least as good as `score`.
    pub(super) fn samples_until(&self, score: f64) -> Option<u64> {
        self.curve.iter().find(|(_, reached)| *reached <= score).map(|(samples, _)| *samples)
    }

    /// The best score on the held-out simulator, cmH2O.
    pub(super) fn best(&self) -> f64 {
        self.curve.iter().map(|(_, score)| *score).fold(f64::INFINITY, f64::min)
    }
}

/// Results of the three methods.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Learning {
    pub(super) ppo: LearnerResult,
    pub(super) dqn: LearnerResult,
    /// Back-propagation through the simulators.
    pub(super) ours: LearnerResult,
}

/// Places of the results.
const PPO: &str = "rl/ppo";
const DQN: &str = "rl/dqn";
const OURS: &str = "rl/ours";
/// Number of pieces: the two algorithms of reinforcement learning, and ours.
pub(super) const PIECES: usize = 3;

/// Training by each of the three on the simulators learned for the middle lung of the list.
pub(super) fn pieces<'a>(study: &'a Study<'_>) -> Result<Vec<Piece<'a>>> {
    let Reproduction { seed, budget, .. } = study.reproduction;
    let index = study.middle();
    let bench = &study.lungs()[index];
    let gains = lungs::tuned(study)?.lungs[index].pid.gains;
    let config = PipelineConfig { gains, seed: *seed, ..budget.lung.clone() };
    // Its folder already contains the whole run.
    let folder = lungs::first_folder(bench);
    let outcome = lungs::train(study, std::slice::from_ref(bench), &config, &folder)?;
    let simulators: Arc<[Simulator]> =
        outcome.plants.into_iter().flat_map(|plant| plant.simulators).collect();
    let by = |place: &'static str, algorithm| {
        let simulators = Arc::clone(&simulators);
        piece(move || study.keep(place, || rival(study, bench, algorithm, &simulators)))
    };
    let [ppo, dqn] = [by(PPO, Algorithm::Ppo), by(DQN, Algorithm::Dqn)];
    Ok(vec![ppo, dqn, piece(move || study.keep(OURS, || ours(study, bench, &config, &simulators)))])
}

/// The kept results, if the folder contains all three.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Learning>> {
    let [ppo, dqn, ours] = [study.kept(PPO)?, study.kept(DQN)?, study.kept(OURS)?];
    Ok(match (ppo, dqn, ours) {
        (Some(ppo), Some(dqn), Some(ours)) => Some(Learning { ppo, dqn, ours }),
        _ => None,
    })
}

fn rival(
    study: &Study<'_>,
    bench: &BenchConfig,
    algorithm: Algorithm,
    simulators: &[Simulator],
) -> Result<LearnerResult> {
    let (held_out, trained_on) = simulators.split_last().ok_or(StudyError::Stopped)?;
    let config = RlConfig { seed: study.reproduction.seed, ..study.reproduction.budget.learners.clone() };
    let trained = train(algorithm, trained_on, held_out, &config, &study.progress.of(algorithm.name()))?;
    Ok(LearnerResult {
        score: evaluate(bench, &trained.policy, &study.plan())?.mean.score,
        samples: trained.curve.last().map_or(0, |(samples, _)| *samples),
        curve: trained.curve,
    })
}

/// Trains our controller from scratch on the same simulators, one shard at a time, because samples are counted here.
fn ours(
    study: &Study<'_>,
    bench: &BenchConfig,
    config: &PipelineConfig,
    simulators: &[Simulator],
) -> Result<LearnerResult> {
    let (held_out, trained_on) = simulators.split_last().ok_or(StudyError::Stopped)?;
    let train = TrainConfig {
        batch: LANES,
        validate_every: OURS_VALIDATED_EVERY,
        seed: study.reproduction.seed,
        ..config.train.clone()
    };
    let ticks = u64::from(shared::math::ticks(train.inspiratory_time, config.period_us));
    let samples = |iteration: usize| (LANES * iteration) as u64 * ticks;
    let iterations = train.iterations;
    let training = Training::new(config.residual(), &[PlantModels { trained_on, held_out }], train, None)?;
    let (plant, seed) = (held_out.plant.clone(), study.reproduction.seed);
    let trained = pipeline::train(training, plant, seed, None, &study.progress.of("ours"))?;
    let curve = trained.curve.iter().map(|point| (samples(point.iteration), point.validation)).collect();
    let controller = Controller::Residual(trained.learned.controller);
    Ok(LearnerResult {
        score: study.evaluate(bench, &controller)?.mean.score,
        samples: samples(iterations),
        curve,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_samples_that_reach_a_score_count() {
        let curve = vec![(10, 3.0), (20, 1.5), (30, 1.8), (40, 1.2)];
        let learner = LearnerResult { score: 1.3, samples: 40, curve };
        assert_eq!(learner.samples_until(1.6), Some(20));
        assert_eq!(learner.samples_until(1.0), None);
        assert!((learner.best() - 1.2).abs() < 1e-12);
    }
}
