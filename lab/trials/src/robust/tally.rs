//! Sums and histograms over the plants of a family.

use campaign::{ExactSum, Sums};
use serde::{Deserialize, Serialize};

use super::histogram::Histogram;
use super::plant_run::{BreathScore, PlantBreaths};
use score::evaluate::ValveEffort;

/// Number of the worst plants that are kept.
const WORST: usize = 10;

/// Results of a plant under its rivals.
#[derive(Clone, Debug, PartialEq)]
pub struct Rivals {
    /// Scored breaths of the plant's own best PID.
    pub own: Vec<BreathScore>,
    /// Reference bounds of the scored breaths, cmH2O.
    pub bound: Vec<f64>,
}

/// Result of a plant. A list that is too short belongs to a run that ended in the safe state.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantResult {
    /// Number of the plant.
    pub number: u32,
    /// Breaths under the controller.
    pub controller: PlantBreaths,
    /// Breaths under the best single PID of the family.
    pub family: PlantBreaths,
    /// Further rivals, if the plant is one of the subset.
    pub rivals: Option<Rivals>,
}

impl PlantResult {
    /// The plant as one of the worst, by its last scored breath; none without that breath.
    fn worst(&self, scored: usize) -> Option<WorstPlant> {
        let last = scored.checked_sub(1)?;
        let (score, family) = (self.controller.scored.get(last)?.score, self.family.scored.get(last)?.score);
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

/// Sums of valve efforts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EffortSum {
    pub total_variation: ExactSum,
    pub deviation: ExactSum,
}

impl EffortSum {
    fn add(&mut self, effort: ValveEffort) {
        self.total_variation.add(effort.total_variation);
        self.deviation.add(effort.deviation);
    }

    fn absorb(&mut self, other: Self) {
        self.total_variation.absorb(other.total_variation);
        self.deviation.absorb(other.deviation);
    }
}

/// Sums over the plants for one scored breath.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BreathTally {
    /// Plants with this breath under both controllers, and the sums over them.
    pub plants: u64,
    pub score: ExactSum,
    pub family: ExactSum,
    pub effort: EffortSum,
    pub family_effort: EffortSum,
    /// Plants on which the controller is not worse than the family's PID.
    pub not_worse: u64,
    /// Values of the controller, and its ratios to the family's PID.
    pub scores: Histogram,
    pub overshoot: Histogram,
    pub ratios: Histogram,
    /// Plants of the subset, and those on which the controller is not worse than the plant's own PID.
    pub subset: u64,
    pub own_not_worse: u64,
    /// Ratios to the plant's own PID.
    pub own_ratios: Histogram,
    /// Plants of the subset with this breath under both the controller and the plant's own PID, and the sums over them.
    pub bounded: u64,
    pub bound_ratio: ExactSum,
    pub bounded_score: ExactSum,
    pub own: ExactSum,
    pub bound: ExactSum,
}

impl BreathTally {
    /// Adds a plant's breath at this place of the scored ones. A rival without the breath was stopped, and is worse.
    fn add(&mut self, result: &PlantResult, place: usize) {
        self.subset += u64::from(result.rivals.is_some());
        let Some(breath) = result.controller.scored.get(place) else { return };
        let not_worse = |rival: Option<&BreathScore>| rival.is_none_or(|rival| breath.score <= rival.score);
        self.scores.add(breath.score);
        self.overshoot.add(breath.overshoot);
        let family = result.family.scored.get(place);
        self.not_worse += u64::from(not_worse(family));
        if let Some(family) = family {
            self.plants += 1;
            self.score.add(breath.score);
            self.family.add(family.score);
            self.effort.add(breath.effort);
            self.family_effort.add(family.effort);
            self.ratios.add(breath.score / family.score);
        }
        if let Some(rivals) = &result.rivals {
            let (own, bound) = (rivals.own.get(place), rivals.bound[place]);
            self.own_not_worse += u64::from(not_worse(own));
            if let Some(own) = own {
                self.own_ratios.add(breath.score / own.score);
                self.bounded += 1;
                self.bound_ratio.add(breath.score / bound);
                self.bounded_score.add(breath.score);
                self.own.add(own.score);
                self.bound.add(bound);
            }
        }
    }

    /// Adds the sums over other plants.
    fn absorb(&mut self, other: Self) {
        self.plants += other.plants;
        self.score.absorb(other.score);
        self.family.absorb(other.family);
        self.effort.absorb(other.effort);
        self.family_effort.absorb(other.family_effort);
        self.not_worse += other.not_worse;
        self.scores.absorb(other.scores);
        self.overshoot.absorb(other.overshoot);
        self.ratios.absorb(other.ratios);
        self.subset += other.subset;
        self.own_not_worse += other.own_not_worse;
        self.own_ratios.absorb(other.own_ratios);
        self.bounded += other.bounded;
        self.bound_ratio.absorb(other.bound_ratio);
        self.bounded_score.absorb(other.bounded_score);
        self.own.absorb(other.own);
        self.bound.absorb(other.bound);
    }
}

/// Counts of plants on which a controller fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failures {
    /// Plants on which the ventilator ended in its safe state.
    pub stopped: u64,
    /// Plants on which the pressure oscillated.
    pub unstable: u64,
    /// Plants on which a breath was worse than the first.
    pub worsened: u64,
    /// Plants on which the pressure limit ended an inspiration, after which the ventilation went on.
    #[serde(default)]
    pub cut: u64,
}

impl Failures {
    fn add(&mut self, breaths: &PlantBreaths, wanted: usize) {
        self.stopped += u64::from(breaths.every.len() < wanted);
        self.unstable += u64::from(breaths.unstable);
        self.worsened += u64::from(breaths.worsened());
        self.cut += u64::from(breaths.cut);
    }

    fn absorb(&mut self, other: Self) {
        self.stopped += other.stopped;
        self.unstable += other.unstable;
        self.worsened += other.worsened;
        self.cut += other.cut;
    }
}

/// Sums for one breath of all, over the plants that have it under both controllers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BreathSum {
    pub plants: u64,
    pub controller: ExactSum,
    pub family: ExactSum,
}

impl BreathSum {
    fn absorb(&mut self, other: Self) {
        self.plants += other.plants;
        self.controller.absorb(other.controller);
        self.family.absorb(other.family);
    }
}

/// All sums of a robustness test.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Sums for every breath.
    pub every: Vec<BreathSum>,
    /// Sums for the scored breaths.
    pub scored: Vec<BreathTally>,
    /// Failures of the controller.
    pub controller: Failures,
    /// Failures of the family's best single PID.
    pub family: Failures,
    /// The plants on which the controller is worst in its last scored breath, relative to the family's PID.
    pub worst: Vec<WorstPlant>,
}

impl Tally {
    /// Sums of no plant yet, for this number of breaths and of scored breaths.
    pub fn new(breaths: usize, scored: usize) -> Self {
        let (every, scored) = (vec![BreathSum::default(); breaths], vec![BreathTally::default(); scored]);
        Self { every, scored, ..Self::default() }
    }

    /// Share of the plants whose ratio to the family's best single PID is at most a value: pairs of value and share for every
    /// scored breath.
    pub fn ratio_distributions(&self) -> Vec<Vec<(f64, f64)>> {
        self.scored.iter().map(|breath| breath.ratios.cumulative()).collect()
    }

    /// Puts plants among the worst.
    fn rank(&mut self, plants: impl IntoIterator<Item = WorstPlant>) {
        self.worst.extend(plants);
        self.worst
            .sort_by(|one, other| other.ratio.total_cmp(&one.ratio).then(one.number.cmp(&other.number)));
        self.worst.truncate(WORST);
    }
}

impl Sums for Tally {
    type Unit = PlantResult;

    fn add(&mut self, _: u64, result: PlantResult) {
        self.controller.add(&result.controller, self.every.len());
        self.family.add(&result.family, self.every.len());
        let both = result.controller.every.iter().zip(&result.family.every);
        for (sum, (controller, family)) in self.every.iter_mut().zip(both) {
            sum.plants += 1;
            sum.controller.add(*controller);
            sum.family.add(*family);
        }
        for (place, tally) in self.scored.iter_mut().enumerate() {
            tally.add(&result, place);
        }
        self.rank(result.worst(self.scored.len()));
    }

    fn absorb(&mut self, other: Self) {
        let Self { every, scored, controller, family, worst } = other;
        self.every.iter_mut().zip(every).for_each(|(sum, other)| sum.absorb(other));
        self.scored.iter_mut().zip(scored).for_each(|(tally, other)| tally.absorb(other));
        self.controller.absorb(controller);
        self.family.absorb(family);
        self.rank(worst);
    }
}
