//! Robustness: a controller on many random plants of a family, beside the best single PID of that family.
//!
//! Every plant gets a waveform of its own, listed or drawn, and a few breaths from rest, once under each controller, with the same sensor noise
//! ([`plant_run`]). For the first plants, a subset, the plant's own best PID and its reference bound are searched as well
//! ([`rivals`]). Only sums and histograms are kept ([`Tally`]), so memory does not grow with the number of plants; their order does not
//! matter, so a test can be divided as any [`campaign`] can. [`Summary`] reads means, shares and quantiles from them.

mod histogram;
pub mod plant_run;
pub mod rivals;
mod summary;
mod tally;
#[cfg(test)]
mod tests;

pub use histogram::Quantiles;
pub use summary::Summary;
pub use tally::{Tally, WorstPlant};

use serde::{Deserialize, Serialize};
use shared::control::ControlLaw;
use shared::control::pid::PidGains;
use thiserror::Error;

use campaign::{Work, WorkspaceError};
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use plant::prescriptions::Prescriptions;
use plant_run::{PlantRun, SCORED, breaths};
use progress::{Stage, Task};
use score::baselines::TuneError;
use score::bound::BoundError;
use tally::{PlantResult, Rivals};
use ventilator::SourceError;

/// A robustness test: plants of a family.
pub const ROBUST: Stage = Stage("plants");

/// Why a robustness test cannot continue.
#[derive(Debug, Error)]
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
    /// The test cannot be kept or continued.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
    /// The controller no longer answers for itself.
    #[error("plant {plant} does not count: {reason}")]
    Controller {
        /// Number of the plant.
        plant: u32,
        /// What happened to the controller.
        reason: String,
    },
}

/// What a robustness test is about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Question {
    /// Name of the family, and its first plant, which shows whether the ranges are the same.
    pub family: String,
    /// See `family`.
    pub first_plant: BenchConfig,
    /// Identifies the controller with everything that changes its results, such as the id of its weights or the gains of its PID.
    pub controller: String,
    /// Gains of the best single PID of the family with these waveforms.
    pub family_pid: PidGains,
    /// Seed of the plants and of the noise.
    pub seed: u64,
    /// The waveforms of the plants.
    #[serde(default)]
    pub prescriptions: Prescriptions,
    /// Breaths on each plant.
    pub breaths: u32,
    /// Number of the first plants whose own best PID and bound are searched.
    pub subset: u32,
}

/// A robustness test; its units are the plants.
#[derive(Clone)]
#[expect(missing_debug_implementations, reason = "a function has none")]
pub struct Robustness<'a, C> {
    /// What it is about.
    pub question: Question,
    /// The family.
    pub family: &'a Family,
    /// The controller.
    pub controller: &'a C,
    /// The failure of a controller that runs elsewhere, from which on its results do not count.
    pub failure: &'a (dyn Fn() -> Option<String> + Sync),
}

impl<C: ControlLaw + Clone + Sync> Work for Robustness<'_, C> {
    type Question = Question;
    type Sums = Tally;
    type Error = RobustError;

    fn question(&self) -> Question {
        self.question.clone()
    }

    fn nothing(&self) -> Tally {
        let scored = SCORED.iter().filter(|breath| **breath <= self.question.breaths).count();
        Tally::new(self.question.breaths as usize, scored)
    }

    fn stage(&self) -> (Stage, f64) {
        (ROBUST, 1.0)
    }

    /// Runs a plant under both controllers, and searches its rivals if it is one of the subset.
    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<PlantResult>, RobustError> {
        let (question, number) = (&self.question, number as u32);
        let run =
            PlantRun::new(self.family, &question.prescriptions, question.seed, number, question.breaths);
        let family_pid = rivals::pid(question.family_pid)?;
        let rivals = if number < question.subset {
            let gains = rivals::own_pid(&run)?;
            Some(Rivals { own: breaths(&run, &rivals::pid(gains)?)?.scored, bound: rivals::bound(&run)? })
        } else {
            None
        };
        let (controller, family) = (breaths(&run, self.controller)?, breaths(&run, &family_pid)?);
        if let Some(reason) = (self.failure)() {
            return Err(RobustError::Controller { plant: number, reason });
        }
        task.advance(1);
        Ok(Some(PlantResult { number, controller, family, rivals }))
    }
}
