//! Sums and histograms over the plants of a family, and their summary.

use serde::{Deserialize, Serialize};

use super::plant_run::{BreathScore, SCORED};

/// Width of a histogram's bins, and their number, in cmH2O: overshoots above the last one count in it.
const BIN_CMH2O: f64 = 0.05;
const BINS: usize = 1200;

/// Scores of a plant under its rivals.
#[derive(Clone, Debug, PartialEq)]
pub struct Rivals {
    /// Scored breaths of the plant's own best PID.
    pub own: Vec<BreathScore>,
    /// Reference bound, cmH2O.
    pub bound: f64,
}

/// Result of a plant. A list that is too short belongs to a run that ended in the safe state.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantResult {
    /// Number of the plant.
    pub number: u32,
    /// Scored breaths under the controller.
    pub controller: Vec<BreathScore>,
    /// Scored breaths under the best single PID of the family.
    pub family: Vec<BreathScore>,
    /// Further rivals, if the plant is one of the subset.
    pub rivals: Option<Rivals>,
}

impl PlantResult {
    /// The plant as one of the worst, by its last scored breath; none without that breath.
    pub fn worst(&self, scored: usize) -> Option<WorstPlant> {
        let last = scored.checked_sub(1)?;
        let (score, family) = (self.controller.get(last)?.score, self.family.get(last)?.score);
        Some(WorstPlant { number: self.number, score, family_pid: family, ratio: score / family })
    }
}

/// A plant on which the controller is bad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorstPlant {
    /// Number of the plant.
    pub number: u32,
    /// Score of the controller, cmH2O.
    pub score: f64,
    /// Score of the best single PID of the family, cmH2O.
    pub family_pid: f64,
    /// Their ratio.
    pub ratio: f64,
}

/// Counts in bins of 0.05 cmH2O.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Histogram(Vec<u64>);

impl Default for Histogram {
    fn default() -> Self {
        Self(vec![0; BINS])
    }
}

impl Histogram {
    fn add(&mut self, value: f64) {
        self.0[((value / BIN_CMH2O) as usize).min(BINS - 1)] += 1;
    }

    /// The value below which this share lies, to the upper end of its bin; 0 without values.
    fn quantile(&self, share: f64) -> f64 {
        let wanted = share * self.0.iter().sum::<u64>() as f64;
        let mut below = 0;
        for (bin, count) in self.0.iter().enumerate() {
            below += count;
            if *count > 0 && below as f64 >= wanted {
                return (bin + 1) as f64 * BIN_CMH2O;
            }
        }
        0.0
    }
}

/// Sums over the plants for one scored breath.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BreathTally {
    /// Plants with this breath under both controllers, and the sums of the two scores.
    plants: u64,
    score: f64,
    family: f64,
    /// Plants on which the controller is not worse than the family's PID.
    not_worse: u64,
    overshoot: Histogram,
    /// Plants of the subset, those on which the controller is not worse than the plant's own PID, those with this breath, and the
    /// sum of their ratios to the bound.
    subset: u64,
    own_not_worse: u64,
    bounded: u64,
    bound_ratio: f64,
}

impl BreathTally {
    /// Adds a plant's breath at this place of the scored ones. A rival without the breath was stopped, and is worse.
    pub fn add(&mut self, result: &PlantResult, place: usize) {
        self.subset += u64::from(result.rivals.is_some());
        let Some(breath) = result.controller.get(place) else { return };
        let not_worse =
            |rival: &[BreathScore]| rival.get(place).is_none_or(|rival| breath.score <= rival.score);
        self.overshoot.add(breath.overshoot);
        self.not_worse += u64::from(not_worse(&result.family));
        if let Some(family) = result.family.get(place) {
            self.plants += 1;
            self.score += breath.score;
            self.family += family.score;
        }
        if let Some(rivals) = &result.rivals {
            self.bounded += 1;
            self.own_not_worse += u64::from(not_worse(&rivals.own));
            self.bound_ratio += breath.score / rivals.bound;
        }
    }
}

/// Results of a robustness test; each list has a value for every scored breath.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Number of plants.
    pub plants: u32,
    /// Plants on which the ventilator ended in its safe state.
    pub stopped: u64,
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
    /// Mean ratio of the controller's score to the plant's bound, over the subset.
    pub bound_ratio: Vec<Option<f64>>,
    /// Median of the overshoot, cmH2O.
    pub overshoot_median: Vec<f64>,
    /// 99th percentile of the overshoot, cmH2O.
    pub overshoot_p99: Vec<f64>,
    /// The worst plants, the worst first.
    pub worst: Vec<WorstPlant>,
}

impl Summary {
    /// The summary of these sums over a number of plants.
    pub fn of(plants: u32, stopped: u64, tallies: &[BreathTally], worst: &[WorstPlant]) -> Self {
        let each = |figure: fn(&BreathTally) -> f64| tallies.iter().map(figure).collect::<Vec<_>>();
        let share = |sum: f64, count: u64| (count > 0).then(|| sum / count as f64);
        let own = |tally: &BreathTally| share(tally.own_not_worse as f64, tally.subset);
        let bound = |tally: &BreathTally| share(tally.bound_ratio, tally.bounded);
        let all = f64::from(plants.max(1));
        Self {
            plants,
            stopped,
            breaths: SCORED[..tallies.len()].to_vec(),
            mean: each(|tally| tally.score / tally.plants.max(1) as f64),
            family_pid: each(|tally| tally.family / tally.plants.max(1) as f64),
            share_not_worse: tallies.iter().map(|tally| tally.not_worse as f64 / all).collect(),
            subset: tallies.iter().map(|tally| tally.subset).max().unwrap_or(0),
            own_not_worse: tallies.iter().map(own).collect(),
            bound_ratio: tallies.iter().map(bound).collect(),
            overshoot_median: each(|tally| tally.overshoot.quantile(0.5)),
            overshoot_p99: each(|tally| tally.overshoot.quantile(0.99)),
            worst: worst.to_vec(),
        }
    }
}
