//! The baselines: the best PID for each lung, and the best single PID for all lungs.
//!
//! Beating a badly tuned PID proves nothing. [`tune_pid`] therefore searches a wide [`Grid`], then refines between its
//! points around the best of each [`PidKind`]. Unless the search is exhaustive, it first screens all points with one
//! breath of a few waveforms and runs only the best twentieth of each kind in full.

mod by_lung;
mod grid;
mod ledger;
#[cfg(test)]
mod tests;

pub use by_lung::{LungScores, PidSearch};
pub use grid::{Grid, PidKind};
pub use ledger::FAULT_SCORE;

use std::collections::BTreeMap;

use campaign::WorkspaceError;
use progress::{Progress, Stage};
use serde::{Deserialize, Serialize};
use shared::control::pid::{GainError, PidGains};
use thiserror::Error;

use crate::evaluate::{Ground, Plan};
use ledger::{Ledger, Patience, Work};
use ventilator::SourceError;

/// Searching gains of a PID: simulated breaths.
pub const TUNE_PID: Stage = Stage("search PID, breaths");

/// Share of each kind's points that passes the screening.
const KEPT: f64 = 0.05;
/// Minimum number of points of a kind that pass.
const KEPT_LEAST: usize = 8;
/// Waveforms of the screening: the lowest, middle and highest PIP of the plan's order.
const SCREENED: usize = 3;
/// Largest number of moves at one step width, in case two points each score the other as better.
const MOVES: usize = 30;

/// Configuration of a search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Search {
    /// The grid to start from.
    pub grid: Grid,
    /// Number of times the grid's spacing is halved around the best of each kind; the refinement may leave the grid's
    /// range. 0 stays on the grid.
    pub refinements: usize,
    /// Run the whole plan for every point, without screening.
    pub exhaustive: bool,
}

impl Default for Search {
    fn default() -> Self {
        Self { grid: Grid::default(), refinements: 3, exhaustive: false }
    }
}

impl Search {
    /// The authors' grid, without refinement.
    pub fn authors() -> Self {
        Self { grid: Grid::authors(), refinements: 0, exhaustive: true }
    }
}

/// Gains with their score.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Gains.
    pub gains: PidGains,
    /// Mean absolute error under the search's plan, cmH2O; [`FAULT_SCORE`] for gains that cause a fault.
    pub score: f64,
}

/// The best gains of every kind. A kind that includes another never scores worse.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Best {
    /// Proportional part only.
    pub p_only: Candidate,
    /// Integral part only.
    pub i_only: Candidate,
    /// PI.
    pub pi: Candidate,
    /// PID.
    pub pid: Candidate,
}

impl Best {
    /// The best of a kind.
    pub fn of(&self, kind: PidKind) -> Candidate {
        match kind {
            PidKind::POnly => self.p_only,
            PidKind::IOnly => self.i_only,
            PidKind::Pi => self.pi,
            PidKind::Pid => self.pid,
        }
    }
}

/// Scores over P and I at D = 0, for a heat map: from the screening, or from the full plan in an exhaustive search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoreMap {
    /// Proportional gains, percent per cmH2O.
    pub p: Vec<f32>,
    /// Integral gains, percent per cmH2O and second.
    pub i: Vec<f32>,
    /// A row for every P, a column for every I, cmH2O; `None` where the search was stopped first.
    pub score: Vec<Vec<Option<f64>>>,
}

/// Result for one lung.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LungResult {
    /// Name of the bench.
    pub lung: String,
    /// The best gains found.
    pub best: Best,
    /// Scores over the grid.
    pub map: ScoreMap,
    /// False if the search was stopped before it finished this lung.
    pub complete: bool,
}

/// Result of a search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TuneResult {
    /// Results by lung, in the given order.
    pub lungs: Vec<LungResult>,
    /// The best single gains for all lungs together, by mean score over the lungs.
    pub over_all: Best,
    /// False if the search was stopped: `lungs` and `over_all` are then the best found so far (at worst, gains of
    /// zero).
    pub complete: bool,
}

/// Why a search failed.
#[derive(Debug, Error)]
pub enum TuneError {
    /// There is no lung to tune for.
    #[error("no lung to tune for: name at least one")]
    NoLung,
    /// The grid contains a gain that no PID accepts.
    #[error(transparent)]
    Gain(#[from] GainError),
    /// A breath could not be run.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The search cannot be divided, kept or merged.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
}

/// Searches the best P, I, PI and PID for each lung and for all of them together, on all threads. The result does not
/// depend on the number of threads.
///
/// A stopped search returns the best found so far, marked incomplete.
///
/// # Errors
/// No lung, a gain in the grid that is out of range, or a plan whose breaths cannot be run. Gains that make the
/// ventilator enter its safe state are no error: they score [`FAULT_SCORE`].
pub fn tune_pid<G: Ground>(
    lungs: &[G],
    search: &Search,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<TuneResult, TuneError> {
    tune_knowing(lungs, &BTreeMap::new(), search, plan, progress)
}

/// The same with what earlier searches on some of the lungs, by their index, have found and measured.
fn tune_knowing<G: Ground>(
    lungs: &[G],
    known: &BTreeMap<u64, LungScores>,
    search: &Search,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<TuneResult, TuneError> {
    let grid = search.grid.completed();
    let work = Work::new(progress.task(TUNE_PID, planned(&grid, search, plan, lungs.len())));
    let mut tuning = Tuning::new(lungs, grid, search, plan, &work)?;
    for (lung, scores) in known {
        tuning.screen.learn(*lung as usize, &scores.screening);
        tuning.full.learn(*lung as usize, &scores.full);
    }
    let all = tuning.begin(lungs.len())?;
    let mut results = Vec::with_capacity(lungs.len());
    for (index, lung) in lungs.iter().enumerate() {
        if let Some(earlier) = known.get(&(index as u64)) {
            results.push(earlier.result.clone());
            continue;
        }
        results.push(tuning.on_lung(index, lung.name(), progress)?);
    }
    let over_all = tuning.best(&all)?;
    work.task.finish();
    let complete = !progress.stopped();
    Ok(TuneResult { lungs: results, over_all, complete })
}

/// Searches the best single P, I, PI and PID for all lungs together, by mean score over the lungs, without the search for each of
/// them.
///
/// # Errors
/// See [`tune_pid`].
pub fn tune_single_pid<G: Ground>(
    lungs: &[G],
    search: &Search,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<Best, TuneError> {
    let grid = search.grid.completed();
    let work = Work::new(progress.task(TUNE_PID, planned(&grid, search, plan, lungs.len())));
    let mut tuning = Tuning::new(lungs, grid, search, plan, &work)?;
    let all = tuning.begin(lungs.len())?;
    let best = tuning.best(&all)?;
    work.task.finish();
    Ok(best)
}

/// A running search.
struct Tuning<'a, G> {
    screen: Ledger<'a, G>,
    full: Ledger<'a, G>,
    points: Vec<PidGains>,
    grid: Grid,
    search: &'a Search,
}

impl<'a, G: Ground> Tuning<'a, G> {
    /// A search that knows nothing yet.
    fn new(
        lungs: &'a [G],
        grid: Grid,
        search: &'a Search,
        plan: &Plan,
        work: &'a Work<'a>,
    ) -> Result<Self, TuneError> {
        if lungs.is_empty() {
            return Err(TuneError::NoLung);
        }
        let (screen, full) =
            (Ledger::new(lungs, screening(plan), work), Ledger::new(lungs, plan.clone(), work));
        Ok(Self { screen, full, points: grid.points(), grid, search })
    }

    /// Finds a first result; returns the indices of all lungs. Gains of zero belong to every kind: with them there is a result even if
    /// the search is stopped immediately.
    fn begin(&mut self, lungs: usize) -> Result<Vec<usize>, TuneError> {
        let all: Vec<usize> = (0..lungs).collect();
        self.full.measure(&all, &[PidGains::default()], Patience::Needed)?;
        Ok(all)
    }

    /// The result for one lung.
    fn on_lung(
        &mut self,
        index: usize,
        lung: String,
        progress: &Progress<'_>,
    ) -> Result<LungResult, TuneError> {
        let best = self.best(&[index])?;
        Ok(LungResult { lung, best, map: self.map(&[index]), complete: !progress.stopped() })
    }

    /// The best of each kind for a group of lungs, by their mean score.
    fn best(&mut self, group: &[usize]) -> Result<Best, TuneError> {
        if self.search.exhaustive {
            self.full.measure(group, &self.points, Patience::Stoppable)?;
        } else {
            self.screen.measure(group, &self.points, Patience::Stoppable)?;
            let shortlists = PidKind::ALL.map(|kind| self.shortlist(group, kind));
            // Even when stopped, score the heads in full, so that the results so far are kept.
            let heads: Vec<PidGains> = shortlists.iter().filter_map(|list| list.first()).copied().collect();
            self.full.measure(group, &heads, Patience::Needed)?;
            self.full.measure(group, &shortlists.concat(), Patience::Stoppable)?;
        }
        for kind in PidKind::ALL {
            self.refine(group, kind)?;
        }
        Ok(Best {
            p_only: self.known(group, PidKind::POnly),
            i_only: self.known(group, PidKind::IOnly),
            pi: self.known(group, PidKind::Pi),
            pid: self.known(group, PidKind::Pid),
        })
    }

    /// A kind's points that passed the screening, best first.
    fn shortlist(&self, group: &[usize], kind: PidKind) -> Vec<PidGains> {
        let of_kind = self.points.iter().filter(|gains| kind.includes(gains));
        let mut scored: Vec<(f64, PidGains)> =
            of_kind.filter_map(|gains| Some((self.screen.score(group, gains)?, *gains))).collect();
        scored.sort_by(|(one, _), (other, _)| one.total_cmp(other));
        scored.truncate(kept(scored.len()));
        scored.into_iter().map(|(_, gains)| gains).collect()
    }

    /// Walks from the best of a kind to better neighbours, with steps of a half, a quarter and so on of the grid's.
    fn refine(&mut self, group: &[usize], kind: PidKind) -> Result<(), TuneError> {
        let mut best = self.known(group, kind);
        let mut step = self.grid.spacing(&best.gains);
        for _ in 0..self.search.refinements {
            step = step.map(|width| 0.5 * width);
            for _ in 0..MOVES {
                let neighbours = grid::around(&best.gains, step, kind);
                self.full.measure(group, &neighbours, Patience::Stoppable)?;
                let next = self.known(group, kind);
                if next == best {
                    break;
                }
                best = next;
            }
        }
        Ok(())
    }

    /// The best known gains of a kind.
    fn known(&self, group: &[usize], kind: PidKind) -> Candidate {
        let nothing = Candidate { gains: PidGains::default(), score: FAULT_SCORE };
        self.full.best(group, kind).unwrap_or(nothing)
    }

    /// Scores over the grid at D = 0.
    fn map(&self, group: &[usize]) -> ScoreMap {
        let source = if self.search.exhaustive { &self.full } else { &self.screen };
        let Grid { p, i, .. } = self.grid.clone();
        let at = |p: f32, i: f32| source.score(group, &PidGains { p, i, d: 0.0 });
        let score = p.iter().map(|p| i.iter().map(|i| at(*p, *i)).collect());
        ScoreMap { score: score.collect(), p, i }
    }
}

/// Number of points that pass the screening.
fn kept(points: usize) -> usize {
    ((points as f64 * KEPT).ceil() as usize).max(KEPT_LEAST)
}

/// The screening's plan: one breath from rest of a few waveforms, under one seed.
fn screening(plan: &Plan) -> Plan {
    let last = plan.waveforms.len().saturating_sub(1);
    let mut indices: Vec<usize> = (0..SCREENED).map(|n| n * last / (SCREENED - 1)).collect();
    indices.dedup();
    Plan {
        waveforms: indices.iter().filter_map(|index| plan.waveforms.get(*index)).copied().collect(),
        breaths: 1,
        warm_up: 0,
        seeds: plan.seeds.iter().take(1).copied().collect(),
        ..plan.clone()
    }
}

/// Number of breaths that a search will run, without its refinement.
fn planned(grid: &Grid, search: &Search, plan: &Plan, lungs: usize) -> usize {
    let points = grid.points();
    let full = plan.breaths_run();
    let breaths = if search.exhaustive {
        points.len() * full
    } else {
        let of_kind = |kind: PidKind| points.iter().filter(|gains| kind.includes(gains)).count();
        let shortlisted: usize = PidKind::ALL.iter().map(|kind| kept(of_kind(*kind))).sum();
        points.len() * screening(plan).breaths_run() + shortlisted * full
    };
    breaths * lungs
}
