//! Robustness: a controller on many random plants of a family, beside the best single PID of that family.
//!
//! Every plant gets one of the family's waveforms and a few breaths from rest, once under each controller, with the same sensor noise
//! ([`plant_run`]). For the first plants, a subset, the plant's own best PID and its reference bound are searched as well
//! ([`rivals`]). Only sums and histograms are kept (`tally`), so memory does not grow with the number of plants; they are added in
//! the order of the plants, so the result depends neither on the number of threads nor on where an earlier run was stopped.
//! [`Summary`] reads means, shares and quantiles from them.

mod histogram;
pub mod plant_run;
pub mod rivals;
mod summary;
mod tally;
#[cfg(test)]
mod tests;

pub use histogram::Quantiles;
pub use summary::Summary;
pub use tally::WorstPlant;

use std::io;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::control::ControlLaw;
use shared::control::pid::PidGains;
use thiserror::Error;

use crate::baselines::TuneError;
use crate::bound::BoundError;
use data::files::{read_json, write_json};
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use plant_run::{PlantRun, SCORED, breaths};
use progress::{Progress, Stage};
use tally::{PlantResult, Rivals, Tally};
use ventilator::SourceError;

/// Plants per thread between two saves.
const BATCH: usize = 32;

/// Why a robustness test cannot continue.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum RobustError {
    /// A plant cannot be run.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The search for a PID failed.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// The search for a bound failed.
    #[error(transparent)]
    Bound(#[from] BoundError),
    /// The progress file could not be used.
    #[error("cannot use {}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// The file belongs to another test.
    #[error("{} belongs to another family, seed, controller or number of breaths: choose another file, or the same options", path.display())]
    OtherTest { path: PathBuf },
}

/// What a robustness test is about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Question {
    /// Name of the family, and its first plant, which shows whether the ranges are the same.
    pub family: String,
    /// See `family`.
    pub first_plant: BenchConfig,
    /// Name of the controller.
    pub controller: String,
    /// Gains of the best single PID of the family.
    pub family_pid: PidGains,
    /// Seed of the plants and of the noise.
    pub seed: u64,
    /// Breaths on each plant.
    pub breaths: u32,
    /// Number of the first plants whose own best PID and bound are searched.
    pub subset: u32,
}

/// A robustness test: its question, and the sums so far. When saved, it can continue later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Robustness {
    question: Question,
    /// Number of the plants that are done: the first ones.
    done: u32,
    tally: Tally,
}

impl Robustness {
    /// A test at its beginning.
    pub fn new(question: Question) -> Self {
        let scored = SCORED.iter().filter(|breath| **breath <= question.breaths).count();
        let tally = Tally::new(question.breaths as usize, scored);
        Self { question, done: 0, tally }
    }

    /// The same test as a file has kept it, or unchanged if there is no such file.
    ///
    /// # Errors
    /// A file that cannot be read, or that belongs to another test.
    pub fn resumed(self, file: &Path) -> Result<Self, RobustError> {
        let Some(kept) = read_json::<Self>(file).map_err(failure(file))? else { return Ok(self) };
        if kept.question == self.question {
            return Ok(kept);
        }
        Err(RobustError::OtherTest { path: file.to_owned() })
    }

    /// Continues until this number of plants is done or it is stopped, and saves the sums if a file is given.
    ///
    /// # Errors
    /// A plant that cannot be run, a failed search, or a file that cannot be written.
    pub fn advance<C: ControlLaw + Clone + Sync>(
        &mut self,
        plants: u32,
        family: &Family,
        controller: &C,
        keep: Option<&Path>,
        progress: &Progress<'_>,
    ) -> Result<(), RobustError> {
        let task = progress.task(Stage::Robust, plants as usize);
        task.reach(self.done.min(plants) as usize);
        let batch = (BATCH * rayon::current_num_threads()) as u32;
        while self.done < plants && !task.stopped() {
            let numbers: Vec<u32> = (self.done..plants.min(self.done + batch)).collect();
            let results: Result<Vec<_>, RobustError> = numbers
                .par_iter()
                .map(|number| {
                    if task.stopped() {
                        return Ok(None);
                    }
                    let result = self.plant(*number, family, controller)?;
                    task.advance(1);
                    Ok(Some(result))
                })
                .collect();
            // A batch that was stopped counts for nothing: its plants are run again.
            let Some(results) = results?.into_iter().collect::<Option<Vec<_>>>() else { break };
            for result in &results {
                self.tally.add(result);
            }
            self.done += results.len() as u32;
            if let Some(file) = keep {
                write_json(file, self).map_err(failure(file))?;
            }
        }
        Ok(())
    }

    /// Runs a plant under both controllers, and searches its rivals if it is one of the subset.
    fn plant<C: ControlLaw + Clone>(
        &self,
        number: u32,
        family: &Family,
        controller: &C,
    ) -> Result<PlantResult, RobustError> {
        let question = &self.question;
        let run = PlantRun::new(family, question.seed, number, question.breaths);
        let family_pid = rivals::pid(question.family_pid)?;
        let rivals = if number < question.subset {
            let gains = rivals::own_pid(&run)?;
            Some(Rivals { own: breaths(&run, &rivals::pid(gains)?)?.scored, bound: rivals::bound(&run)? })
        } else {
            None
        };
        Ok(PlantResult {
            number,
            controller: breaths(&run, controller)?,
            family: breaths(&run, &family_pid)?,
            rivals,
        })
    }

    /// The results so far.
    pub fn summary(&self) -> Summary {
        Summary::of(self.done, &self.tally)
    }

    /// Share of the plants whose ratio to the family's best single PID is at most a value: pairs of value and share for every
    /// scored breath.
    pub fn ratio_distributions(&self) -> Vec<Vec<(f64, f64)>> {
        self.tally.scored.iter().map(|breath| breath.ratios.cumulative()).collect()
    }
}

fn failure(path: &Path) -> impl FnOnce(io::Error) -> RobustError + use<> {
    let path = path.to_owned();
    move |source| RobustError::File { path, source }
}
