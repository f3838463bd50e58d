//! `results.json`: all results as numbers, under stable names. Experiments that were not run are absent.

use serde::{Deserialize, Serialize};

use super::balloon::OnBalloon;
use super::changes::Change;
use super::generalist::Generalist;
use super::iso::IsoResult;
use super::learning::{LearnerResult, Learning};
use super::lungs::LungScores;
use super::study::Study;
use super::unseen::Unseen;
use super::{Ablation, Contest, ablations, learning, lungs, rivals, unseen};
use data::provenance::git_revision;
use plant::bench::BenchConfig;
use score::bound::Bound;
use score::evaluate::{Evaluation, Score, ValveEffort};
use study::Result;

/// Mean scores on one lung, cmH2O.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LungFigures {
    /// Name of the lung.
    pub lung: String,
    /// Resistance, cmH2O/(L/s).
    pub r: f64,
    /// Compliance, mL/cmH2O.
    pub c: f64,
    /// The lung's own best PID.
    pub pid: f64,
    /// The best PID for all lungs.
    pub single_pid: f64,
    /// Mean over the controllers learned for this lung with different seeds.
    pub learned: f64,
    /// Scores of the learned controllers, by seed.
    pub learned_by_seed: Vec<f64>,
    /// The controller learned for all lungs.
    pub generalist: Option<f64>,
    /// The reference bound.
    pub bound: Option<f64>,
}

impl LungFigures {
    /// Share of the gap between best PID and reference bound that the learned controllers close.
    pub fn gap_closed(&self) -> Option<f64> {
        Some((self.pid - self.learned) / (self.pid - self.bound?))
    }

    /// The scores without their spread.
    pub(super) fn scores(&self) -> LungMeans {
        let Self { pid, single_pid, learned, generalist, bound, .. } = *self;
        LungMeans { pid, single_pid, learned, generalist, bound }
    }
}

/// Means over the lungs, cmH2O.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LungMeans {
    /// Each lung's own best PID.
    pub pid: f64,
    /// The best PID for all lungs.
    pub single_pid: f64,
    /// The controllers learned for each lung.
    pub learned: f64,
    /// The controller learned for all lungs.
    pub generalist: Option<f64>,
    /// The reference bound.
    pub bound: Option<f64>,
}

impl LungMeans {
    /// All scores divided by `score`.
    pub(super) fn divided_by(&self, score: f64) -> Self {
        Self {
            pid: self.pid / score,
            single_pid: self.single_pid / score,
            learned: self.learned / score,
            generalist: self.generalist.map(|generalist| generalist / score),
            bound: self.bound.map(|bound| bound / score),
        }
    }
}

/// Valve effort of a controller, mean over the lungs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EffortFigures {
    /// Name of the controller.
    pub controller: String,
    /// The effort.
    #[serde(flatten)]
    pub effort: ValveEffort,
}

/// The authors' own plant: mean of |p - PIP| over the samples, cmH2O.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BalloonFigures {
    /// Full flow, then an exact hold, as an ideal valve would allow.
    pub floor: f64,
    /// The lowest that any commands reach.
    pub bound: f64,
    /// Best PI of the authors' grid.
    pub grid_pi: f64,
    /// Mean over the controllers trained through simulators learned from recordings, with different seeds.
    pub learned: f64,
    /// Scores of those controllers, by seed.
    pub learned_by_seed: Vec<f64>,
}

/// Result of one learning method.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RlFigure {
    /// Score on the true bench, cmH2O.
    pub score: f64,
    /// Simulated control ticks used.
    pub samples: u64,
    /// Ticks until the score on the held-out simulator was within `NEAR` of the best of the three methods.
    pub samples_to_near_best: Option<u64>,
}

/// Largest excess over another score, as a share of it, that counts as near.
pub const NEAR: f64 = 0.02;

/// Results of PPO, DQN and back-propagation on the same simulators.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RlFigures {
    /// Proximal policy optimisation.
    pub ppo: RlFigure,
    /// Deep Q-learning.
    pub dqn: RlFigure,
    /// Back-propagation through the simulators.
    pub ours: RlFigure,
}

/// Scores on a plant not used in training, cmH2O.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnseenFigures {
    /// Description of the plant.
    pub plant: String,
    /// Whether it is within the range of the trained lungs.
    pub inside: bool,
    /// The plant's own best PID.
    pub pid: f64,
    /// The best PID for the trained lungs.
    pub single_pid: f64,
    /// The controller learned for the trained lungs.
    pub generalist: f64,
}

/// A row of the pressure-control test table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IsoFigures {
    /// Row number.
    pub row: u8,
    /// Whether the best single PID stays within the plateau's tolerance.
    pub single_pid: bool,
    /// Whether the controller for all lungs stays within it.
    pub generalist: bool,
    /// Tidal volume under the controller for all lungs, mL; `None` if the ventilator entered its safe state.
    pub tidal_volume: Option<f64>,
    /// Tidal volume that the table expects, mL.
    pub expected_volume: f64,
}

/// The content of `results.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Revision of the program.
    pub revision: String,
    /// Scores on each lung.
    pub lungs: Vec<LungFigures>,
    /// Means over the lungs.
    pub mean: Option<LungMeans>,
    /// Valve effort of the best PIDs and of the learned controllers.
    pub effort: Vec<EffortFigures>,
    /// Highest ratio of the generalist's score to the single PID's over all pairs of lung and waveform.
    pub worst_cell_ratio: Option<f64>,
    /// Plants not used in training.
    pub unseen: Vec<UnseenFigures>,
    /// Rows of the pressure-control test table.
    pub iso_rows: Vec<IsoFigures>,
    /// Largest number of breaths that the generalist needed after a change of the lung.
    pub breaths_to_reconverge: Option<usize>,
    /// The authors' own plant.
    pub balloon: Option<BalloonFigures>,
    /// Comparison with reinforcement learning.
    pub rl: Option<RlFigures>,
    /// Controllers for a whole family of plants, on the lungs and then on the plants not used in training.
    pub rivals: Vec<Contest>,
    /// Contribution of each part of the system.
    pub ablations: Vec<Ablation>,
}

impl Results {
    /// Collects the results in the folder.
    pub(super) fn gather(study: &Study<'_>) -> Result<Self> {
        let kept = lungs::kept(study)?.unwrap_or_default();
        let generalist: Option<Generalist> = study.kept("generalist")?;
        let lungs = lung_figures(study, &kept, generalist.as_ref(), study.kept("bound")?);
        let cells = kept.iter().zip(generalist.iter().flat_map(|generalist| &generalist.lungs));
        let cells = cells.map(|(lung, generalist)| {
            let pairs = generalist.waveforms.iter().zip(&lung.single_pid.waveforms);
            pairs.map(|(learned, pid)| learned.score.score / pid.score.score).fold(0.0, f64::max)
        });
        let changes: Vec<Change> = study.kept("changes")?.unwrap_or_default();
        let unseen: Vec<Unseen> = unseen::kept(study)?.unwrap_or_default();
        let iso: Vec<IsoResult> = study.kept("iso")?.unwrap_or_default();
        Ok(Self {
            seed: study.reproduction.seed,
            revision: git_revision(),
            effort: efforts(&kept, generalist.as_ref()),
            worst_cell_ratio: cells.reduce(f64::max),
            unseen: unseen.into_iter().map(unseen_figures).collect(),
            iso_rows: iso.iter().map(iso_figures).collect(),
            rl: learning::kept(study)?.as_ref().map(rl_figures),
            rivals: rivals::kept(study)?.unwrap_or_default(),
            ablations: ablations::kept(study)?.unwrap_or_default(),
            balloon: study.kept("balloon")?.map(balloon_figures),
            breaths_to_reconverge: changes.iter().map(|c| Change::breaths_to_reconverge(&c.generalist)).max(),
            mean: means(&lungs),
            lungs,
        })
    }
}

/// Scores of each lung.
fn lung_figures(
    study: &Study<'_>,
    kept: &[LungScores],
    generalist: Option<&Generalist>,
    bounds: Option<Vec<Bound>>,
) -> Vec<LungFigures> {
    let bounds = bounds.unwrap_or_default();
    let figures = |(n, (bench, lung)): (usize, (&BenchConfig, &LungScores))| {
        let learned: Vec<f64> = lung.learned.iter().map(|e| e.mean.score).collect();
        LungFigures {
            lung: bench.name.clone(),
            r: bench.lung.first.resistance_cmh2o_per_l_s,
            c: bench.lung.first.compliance_ml_per_cmh2o,
            pid: lung.pid.mean.score,
            single_pid: lung.single_pid.mean.score,
            learned: mean(learned.iter().copied()),
            learned_by_seed: learned,
            generalist: generalist.and_then(|generalist| Some(generalist.lungs.get(n)?.mean.score)),
            bound: bounds.get(n).map(|bound| bound.mean.score),
        }
    };
    study.lungs().iter().zip(kept).enumerate().map(figures).collect()
}

/// Valve efforts, means over the lungs.
fn efforts(lungs: &[LungScores], generalist: Option<&Generalist>) -> Vec<EffortFigures> {
    let mean = |controller: &str, evaluations: Vec<&Evaluation>| {
        let scores: Vec<Score> = evaluations.iter().map(|evaluation| evaluation.mean).collect();
        let effort = Score::mean(&scores).effort;
        (!scores.is_empty()).then(|| EffortFigures { controller: controller.to_owned(), effort })
    };
    [
        mean("own best PID", lungs.iter().map(|lung| &lung.pid).collect()),
        mean("single PID", lungs.iter().map(|lung| &lung.single_pid).collect()),
        mean("learned", lungs.iter().flat_map(|lung| &lung.learned).collect()),
        mean("learned for all", generalist.iter().flat_map(|generalist| &generalist.lungs).collect()),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Means over the lungs, if there are any.
fn means(lungs: &[LungFigures]) -> Option<LungMeans> {
    (!lungs.is_empty()).then(|| LungMeans {
        pid: mean(lungs.iter().map(|lung| lung.pid)),
        single_pid: mean(lungs.iter().map(|lung| lung.single_pid)),
        learned: mean(lungs.iter().map(|lung| lung.learned)),
        generalist: mean_of_all(lungs, |lung| lung.generalist),
        bound: mean_of_all(lungs, |lung| lung.bound),
    })
}

fn rl_figures(found: &Learning) -> RlFigures {
    let best =
        [&found.ppo, &found.dqn, &found.ours].map(LearnerResult::best).into_iter().fold(f64::MAX, f64::min);
    let figure = |learner: &LearnerResult| RlFigure {
        score: learner.score,
        samples: learner.samples,
        samples_to_near_best: learner.samples_until((1.0 + NEAR) * best),
    };
    RlFigures { ppo: figure(&found.ppo), dqn: figure(&found.dqn), ours: figure(&found.ours) }
}

fn unseen_figures(plant: Unseen) -> UnseenFigures {
    UnseenFigures {
        plant: plant.plant,
        inside: plant.inside,
        pid: plant.pid.mean.score,
        single_pid: plant.single_pid.mean.score,
        generalist: plant.generalist.mean.score,
    }
}

fn iso_figures(row: &IsoResult) -> IsoFigures {
    IsoFigures {
        row: row.number,
        single_pid: row.single_pid.is_some_and(|outcome| outcome.plateau_within),
        generalist: row.generalist.is_some_and(|outcome| outcome.plateau_within),
        tidal_volume: row.generalist.map(|outcome| outcome.tidal_volume),
        expected_volume: row.expected_volume,
    }
}

fn balloon_figures(found: OnBalloon) -> BalloonFigures {
    BalloonFigures {
        floor: found.floor,
        bound: found.bound,
        grid_pi: found.grid_pi,
        learned: mean(found.learned.iter().copied()),
        learned_by_seed: found.learned,
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// The mean over the lungs, if every lung has the value.
fn mean_of_all(lungs: &[LungFigures], of: impl Fn(&LungFigures) -> Option<f64>) -> Option<f64> {
    let all = lungs.iter().map(of).collect::<Option<Vec<_>>>()?;
    Some(mean(all.into_iter()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_the_best_is_judged_by_the_best_of_all_three() {
        let learner = |curve: &[(u64, f64)]| LearnerResult { score: 1.0, samples: 9, curve: curve.to_vec() };
        let figures = rl_figures(&Learning {
            ppo: learner(&[(1, 2.0), (5, 1.0)]),
            dqn: learner(&[(1, 1.5), (9, 1.03)]),
            ours: learner(&[(1, 1.02), (2, 1.01)]),
        });
        let until = [figures.ppo, figures.dqn, figures.ours].map(|figure| figure.samples_to_near_best);
        assert_eq!(until, [Some(5), None, Some(1)]);
    }
}
