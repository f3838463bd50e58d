//! The search for the best parameters of a rival: a coarse grid on a few plants, then steps to better neighbours on all of them.
//!
//! The score is the mean error over the first breaths from rest, so that a law that learns from breath to breath is judged by its
//! beginning too. The plants of a family and their sensor noise have a seed of their own, apart from those that users choose.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use serde::Serialize;
use shared::breath::DEFAULT_PERIOD_US;

use super::Rival;
use super::machine::Machine;
use super::parameter::{Parameter, RivalError};
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use progress::{Progress, Stage, Task};
use score::baselines::FAULT_SCORE;
use trials::robust::plant_run::{PlantRun, breaths};
use trials::robust::rivals::TUNING_SEED;
use ventilator::{SourceError, seeds};

/// Searching parameters of a rival: runs of a plant.
pub const TUNE_RIVAL: Stage = Stage("search rival, plants");

/// Plants of a family on which a rival is tuned.
const PLANTS: u32 = 48;
/// Runs that screen the coarse grid: two of each of the paper's waveforms.
const SCREENED: usize = 12;
/// Best points of the grid that are scored on all runs, and those from which the search steps on.
const SHORTLISTED: usize = 12;
const STARTS: usize = 3;
/// Number of times that the steps are halved.
const HALVINGS: usize = 3;
/// Largest number of moves at one width of the steps.
const MOVES: usize = 30;

/// Why a search failed.
#[derive(Debug, thiserror::Error)]
pub enum TuneRivalError {
    /// The law refuses a value of the grid.
    #[error(transparent)]
    Rival(#[from] RivalError),
    /// A plant cannot be run.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// There is no plant.
    #[error("no plant to tune for: name at least one lung")]
    NoPlant,
}

/// The plants and waveforms of a search.
#[derive(Clone, Debug)]
pub struct TuningPlan {
    runs: Vec<PlantRun>,
    machine: Machine,
}

impl TuningPlan {
    /// Plants of a family, whose waveforms take turns.
    pub fn of_family(family: &Family, rival: Rival) -> Self {
        let listed = family.listed();
        let run = |number| PlantRun::new(family, &listed, TUNING_SEED, number, rival.breaths_tuned());
        Self { runs: (0..PLANTS).map(run).collect(), machine: Machine::of(&family.nominal()) }
    }

    /// Each of these benches with all waveforms of the paper, on the machine of the first one with the usual lung of an adult: what a
    /// law knows beforehand is not the lung of the plant.
    ///
    /// # Errors
    /// No bench.
    pub fn of_benches(benches: &[BenchConfig], rival: Rival) -> Result<Self, TuneRivalError> {
        let first = benches.first().ok_or(TuneRivalError::NoPlant)?;
        // Waveform by waveform, so that the first runs are of different lungs.
        let pairs =
            shared::breath::PAPER_PIPS.into_iter().flat_map(|pip| benches.iter().map(move |b| (pip, b)));
        let run = |(number, (pip, bench)): (usize, (f32, &BenchConfig))| PlantRun {
            bench: bench.clone(),
            settings: shared::breath::paper_settings(pip),
            noise: seeds::plant(TUNING_SEED, number as u64),
            breaths: rival.breaths_tuned(),
            goes_on: false,
        };
        let mut machine = Machine::of(first);
        machine.usual = Machine::of(&BenchConfig::default()).usual;
        Ok(Self { runs: pairs.enumerate().map(run).collect(), machine })
    }

    /// Number of plants with a waveform each.
    pub fn runs(&self) -> usize {
        self.runs.len()
    }
}

/// The best parameters found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Tuned {
    /// Values in the order of the rival's parameters.
    pub values: Vec<f32>,
    /// Mean error over all runs and breaths, cmH2O.
    pub score: f64,
    /// Mean error of each breath over all runs, cmH2O; empty if the ventilator stopped on a plant.
    pub by_breath: Vec<f64>,
    /// Number of different values that were scored on all runs.
    pub scored: usize,
    /// False if the search was stopped before its end.
    pub complete: bool,
}

/// Searches the best parameters of a rival on all threads. The result does not depend on their number. A stopped search returns the
/// best found so far.
///
/// # Errors
/// A plant that cannot be run.
pub fn tune(rival: Rival, plan: &TuningPlan, progress: &Progress<'_>) -> Result<Tuned, TuneRivalError> {
    search(rival, &grid(rival.parameters()), plan, progress)
}

/// Searches from these points, which are not empty.
fn search(
    rival: Rival,
    grid: &[Vec<f32>],
    plan: &TuningPlan,
    progress: &Progress<'_>,
) -> Result<Tuned, TuneRivalError> {
    let screened = SCREENED.min(plan.runs.len());
    let planned = AtomicUsize::new(0);
    let task = progress.task(TUNE_RIVAL, grid.len() * screened);
    let mut screen = Scores::new(rival, plan, screened, (&task, &planned));
    let mut full = Scores::new(rival, plan, plan.runs.len(), (&task, &planned));
    // With the middle of the grid there is a result even if the search is stopped immediately.
    full.measure(&[grid[grid.len() / 2].clone()], false)?;
    screen.measure(grid, true)?;
    full.measure(&screen.best(SHORTLISTED), true)?;
    for start in full.best(STARTS) {
        refine(rival.parameters(), &mut full, start)?;
    }
    task.finish();
    let (values, score) = full.leader();
    let law = rival.law(&values, plan.machine, DEFAULT_PERIOD_US)?;
    let every: Result<Vec<_>, SourceError> =
        plan.runs.par_iter().map(|run| Ok(breaths(run, &law)?.every)).collect();
    Ok(Tuned {
        by_breath: by_breath(&every?, rival.breaths_tuned() as usize),
        values,
        score,
        scored: full.known.len(),
        complete: !progress.stopped(),
    })
}

/// Steps from a point to its best neighbour until none is better, with ever smaller steps.
fn refine(parameters: &[Parameter], scores: &mut Scores<'_>, start: Vec<f32>) -> Result<(), TuneRivalError> {
    let mut steps: Vec<f32> =
        parameters.iter().zip(&start).map(|(parameter, value)| parameter.step(*value)).collect();
    let mut point = start;
    for _ in 0..=HALVINGS {
        for _ in 0..MOVES {
            let neighbours = neighbours(parameters, &point, &steps);
            scores.measure(&neighbours, true)?;
            match scores.better(&point, &neighbours) {
                Some(next) => point = next,
                None => break,
            }
        }
        for step in &mut steps {
            *step *= 0.5;
        }
    }
    Ok(())
}

/// The points one step away along each axis, within the bounds.
fn neighbours(parameters: &[Parameter], point: &[f32], steps: &[f32]) -> Vec<Vec<f32>> {
    let mut all = Vec::new();
    for (axis, parameter) in parameters.iter().enumerate() {
        let (least, most) = parameter.bounds;
        for value in [point[axis] - steps[axis], point[axis] + steps[axis]] {
            let mut neighbour = point.to_vec();
            neighbour[axis] = value.clamp(least, most);
            all.push(neighbour);
        }
    }
    all
}

/// Every combination of the coarse values; the last parameter varies fastest.
fn grid(parameters: &[Parameter]) -> Vec<Vec<f32>> {
    parameters.iter().fold(vec![Vec::new()], |points, parameter| {
        let longer = |point: &Vec<f32>| {
            let point = point.clone();
            parameter.coarse.iter().map(move |value| [point.as_slice(), &[*value]].concat())
        };
        points.iter().flat_map(longer).collect()
    })
}

/// Scores of points on the first runs of a plan; each is measured once.
struct Scores<'a> {
    rival: Rival,
    machine: Machine,
    runs: &'a [PlantRun],
    task: &'a Task<'a>,
    /// Breaths announced to the task: how many points the refinement needs is not known before.
    planned: &'a AtomicUsize,
    /// By the bits of the values, which sort like the values: none is negative.
    known: BTreeMap<Vec<u32>, f64>,
}

impl<'a> Scores<'a> {
    fn new(
        rival: Rival,
        plan: &'a TuningPlan,
        runs: usize,
        (task, planned): (&'a Task<'a>, &'a AtomicUsize),
    ) -> Self {
        Self { rival, machine: plan.machine, runs: &plan.runs[..runs], task, planned, known: BTreeMap::new() }
    }

    /// Scores all points that are not known; those that are not done when a stoppable measurement is stopped stay unknown.
    fn measure(&mut self, points: &[Vec<f32>], stoppable: bool) -> Result<(), TuneRivalError> {
        let mut unknown: Vec<&Vec<f32>> =
            points.iter().filter(|point| !self.known.contains_key(&key(point))).collect();
        unknown.sort_by_key(|point| key(point));
        unknown.dedup();
        let more = unknown.len() * self.runs.len();
        self.task.expect(self.planned.fetch_add(more, Ordering::Relaxed) + more);
        let scored: Result<Vec<Option<f64>>, TuneRivalError> = unknown
            .par_iter()
            .map(|point| {
                let law = self.rival.law(point, self.machine, DEFAULT_PERIOD_US)?;
                let mut sum = 0.0;
                for run in self.runs {
                    if stoppable && self.task.stopped() {
                        return Ok(None);
                    }
                    sum += mean(&breaths(run, &law)?.every, run.breaths as usize);
                    self.task.advance(1);
                }
                Ok(Some(sum / self.runs.len() as f64))
            })
            .collect();
        let scored = scored?;
        self.known.extend(unknown.iter().zip(scored).filter_map(|(point, score)| Some((key(point), score?))));
        Ok(())
    }

    fn of(&self, point: &[f32]) -> Option<f64> {
        self.known.get(&key(point)).copied()
    }

    /// The best points, best first; among equals, the smaller values first.
    fn best(&self, count: usize) -> Vec<Vec<f32>> {
        let mut all: Vec<_> = self.known.iter().collect();
        all.sort_by(|(_, one), (_, other)| one.total_cmp(other));
        all.into_iter().take(count).map(|(key, _)| values(key)).collect()
    }

    /// The best neighbour, if it is better than the point.
    fn better(&self, point: &[f32], neighbours: &[Vec<f32>]) -> Option<Vec<f32>> {
        let own = self.of(point)?;
        let known = neighbours.iter().filter_map(|neighbour| Some((self.of(neighbour)?, neighbour)));
        let (score, best) = known.min_by(|(one, _), (other, _)| one.total_cmp(other))?;
        (score < own).then(|| best.clone())
    }

    /// The best point, with its score.
    fn leader(&self) -> (Vec<f32>, f64) {
        let best = self.best(1).into_iter().next().unwrap_or_default();
        let score = self.of(&best).unwrap_or(FAULT_SCORE);
        (best, score)
    }
}

fn key(point: &[f32]) -> Vec<u32> {
    // Adding zero turns a negative zero into a positive one.
    point.iter().map(|value| (value + 0.0).to_bits()).collect()
}

fn values(key: &[u32]) -> Vec<f32> {
    key.iter().map(|bits| f32::from_bits(*bits)).collect()
}

/// Mean error over the breaths of a run, cmH2O; [`FAULT_SCORE`] if the ventilator stopped.
fn mean(every: &[f64], breaths: usize) -> f64 {
    if every.len() < breaths { FAULT_SCORE } else { every.iter().sum::<f64>() / breaths as f64 }
}

/// Mean error of each breath over all runs; empty if one of them ended early.
fn by_breath(runs: &[Vec<f64>], breaths: usize) -> Vec<f64> {
    if runs.iter().any(|every| every.len() < breaths) {
        return Vec::new();
    }
    let mean = |breath| runs.iter().map(|every: &Vec<f64>| every[breath]).sum::<f64>() / runs.len() as f64;
    (0..breaths).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::ThreadPoolBuilder;
    use std::sync::atomic::AtomicBool;

    /// One breath on one lung.
    fn plan() -> TuningPlan {
        let benches = [BenchConfig::paper(20.0, 20.0)];
        let mut plan = TuningPlan::of_benches(&benches, Rival::VariableGain).unwrap();
        plan.runs.truncate(2);
        plan.runs.iter_mut().for_each(|run| run.breaths = 1);
        plan
    }

    fn points() -> Vec<Vec<f32>> {
        [1.0, 20.0].iter().map(|p| vec![*p, 75.0, 0.1, 1.0, 5.0]).collect()
    }

    #[test]
    fn on_benches_a_law_does_not_know_their_lung() {
        let plan = TuningPlan::of_benches(&[BenchConfig::paper(50.0, 10.0)], Rival::FeedForward).unwrap();
        assert_eq!(plan.machine.usual, Machine::of(&BenchConfig::default()).usual);
    }

    #[test]
    fn the_search_steps_from_the_best_point_to_a_better_one_whatever_the_number_of_threads() {
        let with = |threads| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| search(Rival::VariableGain, &points(), &plan(), &Progress::silent()).unwrap())
        };
        let found = with(1);
        assert_eq!(found, with(2));
        let task = Progress::silent().task(TUNE_RIVAL, 1);
        let plan = plan();
        let planned = AtomicUsize::new(0);
        let mut scores = Scores::new(Rival::VariableGain, &plan, plan.runs(), (&task, &planned));
        scores.measure(&points(), false).unwrap();
        assert!(found.score < 0.95 * scores.leader().1, "{found:?}");
        assert!(found.complete);
    }

    #[test]
    fn a_stopped_search_has_a_result_that_is_marked() {
        let stop = AtomicBool::new(true);
        let found = search(Rival::VariableGain, &points(), &plan(), &Progress::quiet(&stop)).unwrap();
        assert_eq!((found.values, found.complete), (points()[1].clone(), false));
    }

    #[test]
    fn the_grid_has_every_combination() {
        let parameters = Rival::Iterative.parameters();
        let count: usize = parameters.iter().map(|parameter| parameter.coarse.len()).product();
        let grid = grid(parameters);
        assert_eq!(grid.len(), count);
        assert_eq!(grid[1][..5], grid[0][..5], "the last parameter varies fastest");
    }

    #[test]
    fn neighbours_are_one_step_away_on_one_axis_and_within_the_bounds() {
        let parameters = Rival::VariableGain.parameters();
        let all = neighbours(parameters, &[1.0, 75.0, 0.0, 1.0, 5.0], &[0.5, 20.0, 0.1, 0.5, 1.0]);
        assert_eq!(all.len(), 10);
        assert_eq!(all[0], [0.5, 75.0, 0.0, 1.0, 5.0]);
        assert_eq!(all[4], [1.0, 75.0, 0.0, 1.0, 5.0], "no negative gain");
    }

    #[test]
    fn a_run_that_ends_in_the_safe_state_scores_worse_than_any_other() {
        assert!((mean(&[2.0, 4.0], 2) - 3.0).abs() < 1e-12);
        assert!((mean(&[2.0], 2) - FAULT_SCORE).abs() < 1e-12);
        assert_eq!(by_breath(&[vec![1.0, 2.0], vec![3.0, 6.0]], 2), [2.0, 4.0]);
        assert!(by_breath(&[vec![1.0, 2.0], vec![3.0]], 2).is_empty());
    }

    #[test]
    fn the_plants_are_not_those_of_a_users_seed() {
        let family = Family::find("adult").unwrap();
        let plan = TuningPlan::of_family(&family, Rival::FeedForward);
        assert_eq!((plan.runs(), plan.runs[0].breaths), (48, 6));
        assert_ne!(plan.runs[0].bench, family.draw(1, 0));
    }
}
