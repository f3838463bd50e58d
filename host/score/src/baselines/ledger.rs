//! Known scores of gains on lungs under one plan; each is measured once.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicUsize, Ordering};

use progress::{Progress, Task};
use rayon::prelude::*;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use super::grid::PidKind;
use super::{Candidate, TuneError};
use crate::evaluate::{Ground, Plan};
use ventilator::SourceError;

/// Score of gains with which the ventilator enters its safe state, cmH2O: worse than any real score, yet finite.
pub const FAULT_SCORE: f64 = 1000.0;

/// The running search, counted in simulated breaths; refinement may take more than planned.
pub(super) struct Work<'a> {
    pub(super) task: Task<'a>,
    announced: AtomicUsize,
}

impl<'a> Work<'a> {
    pub(super) fn new(task: Task<'a>) -> Self {
        Self { task, announced: AtomicUsize::new(0) }
    }

    fn announce(&self, breaths: usize) {
        self.task.expect(self.announced.fetch_add(breaths, Ordering::Relaxed) + breaths);
    }
}

/// Whether a measurement may be skipped when the user wants to stop.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Patience {
    /// It may be skipped.
    Stoppable,
    /// It must run: without it there is no result.
    Needed,
}

/// Gains as a key: the bits of non-negative floats sort like the floats.
type Key = [u32; 3];

/// Scores by gains and lung.
pub(super) struct Ledger<'a, G> {
    grounds: &'a [G],
    plan: Plan,
    work: &'a Work<'a>,
    scores: BTreeMap<Key, Vec<Option<f64>>>,
}

impl<'a, G: Ground> Ledger<'a, G> {
    pub fn new(grounds: &'a [G], plan: Plan, work: &'a Work<'a>) -> Self {
        Self { grounds, plan, work, scores: BTreeMap::new() }
    }

    /// Measures all unknown scores of the candidates on the lungs of a group.
    pub fn measure(
        &mut self,
        group: &[usize],
        candidates: &[PidGains],
        patience: Patience,
    ) -> Result<(), TuneError> {
        let missing: BTreeSet<(Key, usize)> = candidates
            .iter()
            .flat_map(|gains| group.iter().map(move |lung| (key(gains), *lung)))
            .filter(|(key, lung)| self.scores.get(key).is_none_or(|lungs| lungs[*lung].is_none()))
            .collect();
        let missing: Vec<(Key, usize)> = missing.into_iter().collect();
        let cost = self.plan.breaths_run();
        self.work.announce(cost * missing.len());
        let outcomes: Vec<Result<Option<f64>, TuneError>> = missing
            .par_iter()
            .map(|(key, lung)| {
                if patience == Patience::Stoppable && self.work.task.stopped() {
                    return Ok(None);
                }
                let score = score(&self.grounds[*lung], gains(*key), &self.plan)?;
                self.work.task.advance(cost);
                Ok(Some(score))
            })
            .collect();
        for ((key, lung), outcome) in missing.into_iter().zip(outcomes) {
            if let Some(score) = outcome? {
                let lungs = self.scores.entry(key);
                lungs.or_insert_with(|| vec![None; self.grounds.len()])[lung] = Some(score);
            }
        }
        Ok(())
    }

    /// All known scores on a lung.
    pub fn on(&self, lung: usize) -> Vec<Candidate> {
        let known = |(key, lungs): (&Key, &Vec<Option<f64>>)| {
            Some(Candidate { gains: gains(*key), score: lungs[lung]? })
        };
        self.scores.iter().filter_map(known).collect()
    }

    /// Adds scores on a lung that an earlier search has measured.
    pub fn learn(&mut self, lung: usize, known: &[Candidate]) {
        for Candidate { gains, score } in known {
            let lungs = self.scores.entry(key(gains));
            lungs.or_insert_with(|| vec![None; self.grounds.len()])[lung] = Some(*score);
        }
    }

    /// Mean score over a group of lungs, cmH2O; `None` if one of them is unknown.
    pub fn score(&self, group: &[usize], gains: &PidGains) -> Option<f64> {
        mean(group, self.scores.get(&key(gains))?)
    }

    /// The best gains of a kind that are known for every lung of a group; among equals, the smallest.
    pub fn best(&self, group: &[usize], kind: PidKind) -> Option<Candidate> {
        let known = self.scores.iter().filter_map(|(key, lungs)| {
            let (gains, score) = (gains(*key), mean(group, lungs)?);
            kind.includes(&gains).then_some(Candidate { gains, score })
        });
        known.min_by(|one, other| one.score.total_cmp(&other.score))
    }
}

/// Mean score over a group of lungs; `None` if one of them is unknown.
fn mean(group: &[usize], lungs: &[Option<f64>]) -> Option<f64> {
    let known: Option<Vec<f64>> = group.iter().map(|lung| lungs[*lung]).collect();
    Some(known?.iter().sum::<f64>() / group.len() as f64)
}

fn key(gains: &PidGains) -> Key {
    // Adding zero turns a negative zero into a positive one.
    [gains.p, gains.i, gains.d].map(|gain| (gain + 0.0).to_bits())
}

fn gains(key: Key) -> PidGains {
    let [p, i, d] = key.map(f32::from_bits);
    PidGains { p, i, d }
}

/// Mean score of gains on a lung, cmH2O; [`FAULT_SCORE`] if the ventilator enters its safe state.
fn score(ground: &impl Ground, gains: PidGains, plan: &Plan) -> Result<f64, TuneError> {
    let controller = Controller::Pid(Pid::new(gains, plan.period_us)?);
    match ground.evaluate(&controller, plan, &Progress::silent()) {
        Ok(evaluation) => Ok(evaluation.mean.score),
        Err(SourceError::Fault { .. }) => Ok(FAULT_SCORE),
        Err(other) => Err(other.into()),
    }
}
