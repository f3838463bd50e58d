//! The search for the best PIDs of many lungs as a campaign, whose units are the lungs.
//!
//! A unit searches one lung and returns all scores that it has measured. With those of all lungs, the search for the best PID over all
//! of them only has its own shortlist to measure.

use std::collections::BTreeMap;

use campaign::{Sums, Work};
use serde::{Deserialize, Serialize};

use super::ledger::Work as Running;
use super::{Candidate, LungResult, Search, TUNE_PID, TuneError, TuneResult, Tuning, planned, tune_knowing};
use crate::evaluate::Plan;
use plant::bench::BenchConfig;
use progress::{Progress, Stage, Task};

/// A search on many lungs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PidSearch {
    /// The lungs.
    pub lungs: Vec<BenchConfig>,
    /// The grid and its refinement.
    pub search: Search,
    /// The breaths by which gains are scored.
    pub plan: Plan,
}

/// What a search on one lung has found and measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LungScores {
    /// Its result.
    pub result: LungResult,
    /// Scores of the screening.
    pub screening: Vec<Candidate>,
    /// Scores of the whole plan.
    pub full: Vec<Candidate>,
}

/// Scores by the lung's number.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct KnownScores(BTreeMap<u64, LungScores>);

impl Sums for KnownScores {
    type Unit = LungScores;

    fn add(&mut self, lung: u64, scores: LungScores) {
        self.0.insert(lung, scores);
    }

    fn absorb(&mut self, other: Self) {
        self.0.extend(other.0);
    }
}

impl PidSearch {
    /// The results, equal to those of [`super::tune_pid`]: what is known is not measured again.
    ///
    /// # Errors
    /// See [`super::tune_pid`].
    pub fn finish(&self, known: &KnownScores, progress: &Progress<'_>) -> Result<TuneResult, TuneError> {
        tune_knowing(&self.lungs, &known.0, &self.search, &self.plan, progress)
    }
}

impl Work for PidSearch {
    type Question = Self;
    type Sums = KnownScores;
    type Error = TuneError;

    fn question(&self) -> Self {
        self.clone()
    }

    fn nothing(&self) -> KnownScores {
        KnownScores::default()
    }

    fn stage(&self) -> (Stage, f64) {
        (TUNE_PID, planned(&self.search.grid.completed(), &self.search, &self.plan, 1) as f64)
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<LungScores>, TuneError> {
        let (lungs, part) = (&self.lungs[number as usize..=number as usize], task.part());
        let running = Running::new(part.task(TUNE_PID, 0));
        let grid = self.search.grid.completed();
        let mut tuning = Tuning::new(lungs, grid, &self.search, &self.plan, &running)?;
        tuning.begin(lungs.len())?;
        let result = tuning.on_lung(0, lungs[0].name.clone(), &part)?;
        // A search that was stopped is no result of the lung.
        Ok(result.complete.then(|| LungScores {
            result,
            screening: tuning.screen.on(0),
            full: tuning.full.on(0),
        }))
    }
}
