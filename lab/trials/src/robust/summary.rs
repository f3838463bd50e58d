//! Summary of a robustness test: means, shares and quantiles.

use campaign::{Campaign, ExactSum};
use serde::{Deserialize, Serialize};

use super::Question;
use super::histogram::Quantiles;
use super::plant_run::SCORED;
use super::tally::{BreathSum, BreathTally, EffortSum, Failures, Tally, WorstPlant};
use score::evaluate::ValveEffort;

/// Results of a robustness test; each list has a value for every scored breath, unless it says otherwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Number of plants.
    pub plants: u32,
    /// Numbers of the scored breaths.
    pub breaths: Vec<u32>,
    /// Mean score of the controller, cmH2O.
    pub mean: Vec<f64>,
    /// Mean score of the family's best single PID, cmH2O.
    pub family_pid: Vec<f64>,
    /// Share of the plants on which the controller is not worse than that PID.
    pub share_not_worse: Vec<f64>,
    /// Number of plants in the subset.
    pub subset: u64,
    /// Share of the subset on which the controller is not worse than the plant's own best PID; none without a subset.
    pub own_not_worse: Vec<Option<f64>>,
    /// Ratio of the controller's mean score to the mean bound, over the subset.
    pub bound_ratio: Vec<Option<f64>>,
    /// Mean of the plants' own ratios to their bounds: plants with a small bound weigh more.
    pub bound_ratio_each: Vec<Option<f64>>,
    /// Mean score of the plants' own best PIDs, over the subset, cmH2O.
    pub own_pid: Vec<Option<f64>>,
    /// Mean bound, over the subset, cmH2O.
    pub bound: Vec<Option<f64>>,
    /// Median of the overshoot, cmH2O.
    pub overshoot_median: Vec<f64>,
    /// 99th percentile of the overshoot, cmH2O.
    pub overshoot_p99: Vec<f64>,
    /// Mean valve effort of the controller.
    pub effort: Vec<ValveEffort>,
    /// Mean valve effort of the family's best single PID.
    pub family_effort: Vec<ValveEffort>,
    /// Quantiles of the controller's scores, cmH2O; none without plants.
    pub scores: Vec<Option<Quantiles>>,
    /// Quantiles of the ratios to the family's best single PID.
    pub ratios: Vec<Option<Quantiles>>,
    /// Quantiles of the ratios to the plant's own best PID, over the subset.
    pub own_ratios: Vec<Option<Quantiles>>,
    /// Share of the plants with a breath that is worse than the first by more than 5 % and by more than 0.3 cmH2O.
    pub worsened: f64,
    /// The same under the family's best single PID.
    pub family_worsened: f64,
    /// Plants on which the pressure oscillates on the plateau of a breath by more than the plateau may be off, 2 cmH2O + 4 % of
    /// PIP to either side.
    pub unstable: u64,
    /// The same under the family's best single PID.
    pub family_unstable: u64,
    /// Plants on which the ventilator ended in its safe state.
    pub stopped: u64,
    /// The same under the family's best single PID.
    pub family_stopped: u64,
    /// Plants on which the pressure limit ended an inspiration, after which the ventilation went on: with drawn limits only.
    pub cut: u64,
    /// The same under the family's best single PID.
    pub family_cut: u64,
    /// Mean score of every breath, cmH2O.
    pub mean_by_breath: Vec<f64>,
    /// Mean score of every breath under the family's best single PID, cmH2O.
    pub family_pid_by_breath: Vec<f64>,
    /// The worst plants, the worst first.
    pub worst: Vec<WorstPlant>,
}

impl Summary {
    /// The summary of a test so far.
    pub fn of(test: &Campaign<Question, Tally>) -> Self {
        Self::of_plants(test.units() as u32, test.sums())
    }

    /// The summary of these sums over a number of plants.
    pub(super) fn of_plants(plants: u32, tally: &Tally) -> Self {
        let Tally { every, scored, controller, family, worst } = tally;
        let all = f64::from(plants.max(1));
        let by_breath = |figure: fn(&BreathSum) -> ExactSum| {
            every.iter().map(|sum| figure(sum).value() / sum.plants.max(1) as f64).collect::<Vec<_>>()
        };
        let worsened = |failures: &Failures| failures.worsened as f64 / all;
        Self {
            plants,
            breaths: SCORED[..scored.len()].to_vec(),
            mean: each(scored, |tally| mean(tally.score, tally)),
            family_pid: each(scored, |tally| mean(tally.family, tally)),
            share_not_worse: each(scored, |tally| tally.not_worse as f64 / all),
            subset: scored.iter().map(|tally| tally.subset).max().unwrap_or(0),
            own_not_worse: each(scored, |tally| share(tally.own_not_worse as f64, tally.subset)),
            bound_ratio: each(scored, |tally| {
                (tally.bounded > 0).then(|| tally.bounded_score.value() / tally.bound.value())
            }),
            bound_ratio_each: each(scored, |tally| share(tally.bound_ratio.value(), tally.bounded)),
            own_pid: each(scored, |tally| share(tally.own.value(), tally.bounded)),
            bound: each(scored, |tally| share(tally.bound.value(), tally.bounded)),
            overshoot_median: each(scored, |tally| tally.overshoot.quantile(0.5)),
            overshoot_p99: each(scored, |tally| tally.overshoot.quantile(0.99)),
            effort: each(scored, |tally| mean_effort(tally.effort, tally)),
            family_effort: each(scored, |tally| mean_effort(tally.family_effort, tally)),
            scores: each(scored, |tally| tally.scores.quantiles()),
            ratios: each(scored, |tally| tally.ratios.quantiles()),
            own_ratios: each(scored, |tally| tally.own_ratios.quantiles()),
            worsened: worsened(controller),
            family_worsened: worsened(family),
            unstable: controller.unstable,
            family_unstable: family.unstable,
            stopped: controller.stopped,
            family_stopped: family.stopped,
            cut: controller.cut,
            family_cut: family.cut,
            mean_by_breath: by_breath(|sum| sum.controller),
            family_pid_by_breath: by_breath(|sum| sum.family),
            worst: worst.clone(),
        }
    }
}

/// A figure of every scored breath.
fn each<T>(scored: &[BreathTally], figure: impl Fn(&BreathTally) -> T) -> Vec<T> {
    scored.iter().map(figure).collect()
}

/// Mean over the plants with the breath under both controllers; 0 without plants.
fn mean(sum: ExactSum, tally: &BreathTally) -> f64 {
    sum.value() / tally.plants.max(1) as f64
}

fn mean_effort(sum: EffortSum, tally: &BreathTally) -> ValveEffort {
    ValveEffort { total_variation: mean(sum.total_variation, tally), deviation: mean(sum.deviation, tally) }
}

fn share(sum: f64, count: u64) -> Option<f64> {
    (count > 0).then(|| sum / count as f64)
}
