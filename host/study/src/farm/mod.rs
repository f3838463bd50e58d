//! A farm: several ventilators at once, from their recordings to a controller for all and one for each.
//!
//! ```text
//! contact    every unit answers, and as the one it was                        contact.rs
//! collect    zero of the sensor, then breaths under a PID that explores       session.rs, measure.rs
//! fit        a simulator of each unit; the calibration, stored on the device  fit.rs
//! train      one controller for the farm, then one for each unit              controllers.rs
//! crosswise  every controller on every unit                                   crosswise.rs
//! flash      each unit gets the controller that was best on it, read back     flash.rs
//! ```
//!
//! Stages that move valves run on all units at once, each on a thread of its own: a unit that fails never stops the rest. Every stage
//! saves its results in the folder, and the same call continues a farm that was stopped, or killed.

mod alone;
mod band;
mod contact;
mod controllers;
mod crosswise;
pub mod description;
mod drift;
mod figures;
mod fit;
mod flash;
mod folder;
mod measure;
pub mod report;
mod rivals;
mod session;
#[cfg(test)]
mod tests;
mod unit_name;

use std::convert::Infallible;
use std::path::PathBuf;
use std::time::Duration;

use campaign::on_threads;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use shared::calibration::Calibration;
use shared::control::residual::Residual;

use crate::error::{Result, StudyError};
pub use alone::{Alone, OnBench, Scores};
pub use band::{Band, Outside};
use contact::Contact;
pub use crosswise::{Matrix, MatrixRow};
use data::workspace::Workspace;
use description::{Farm, Unit};
pub use drift::Drift;
pub use figures::UnitFigures;
use learn::pipeline::commission::CommissionRun;
use progress::Progress;
pub use rivals::Rivals;
pub use unit_name::UnitName;

/// How the simulators are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Simulators {
    /// One for each unit.
    Each,
    /// One for all units, with parameters of each.
    One,
}

/// The stages, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum FarmStage {
    /// Every unit answers.
    Contact,
    /// Recordings.
    Collect,
    /// Simulators and calibrations.
    Fit,
    /// Controllers.
    Train,
    /// Every controller on every unit.
    Crosswise,
    /// The controllers on the units.
    Flash,
}

/// Configuration of a farm's run; all of it must match to continue.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FarmConfig {
    /// Collection, fits and training.
    pub run: CommissionRun,
    /// Gradient steps of the controller for the farm; those for one unit are in `run`.
    pub farm_iterations: usize,
    /// How the simulators are fitted.
    pub simulators: Simulators,
    /// Unscored breaths of the crosswise evaluation, in which a controller learns from breath to breath.
    pub breaths_of_learning: usize,
    /// Scored breaths after them, of each PIP.
    pub scored_breaths: usize,
}

/// What a run may use, and how far it goes.
pub struct FarmRun<'a> {
    /// The farm.
    pub farm: &'a Farm,
    /// The configuration.
    pub config: FarmConfig,
    /// Name of the controller to start from, and the controller.
    pub start: (&'a str, &'a Residual),
    /// Folder of the farm.
    pub out: PathBuf,
    /// Units whose device was replaced.
    pub adopt: Vec<UnitName>,
    /// Measure every unit again, and compare with earlier calibrations.
    pub recalibrate: bool,
    /// The last stage to run.
    pub until: FarmStage,
    /// Time to wait for a unit that does not answer.
    pub patience: Duration,
    /// Factor by which devices in this process are faster than a chip.
    pub pace: u32,
    /// Signs a weights image.
    pub sign: &'a (dyn Fn(Vec<u8>) -> std::result::Result<Vec<u8>, String> + Sync),
    /// Told of what happens to a unit.
    pub tell: &'a (dyn Fn(&UnitName, &str) + Sync),
}

/// A unit after a run.
#[derive(Clone, Debug, Serialize)]
pub struct UnitResult {
    /// Its name.
    pub name: UnitName,
    /// Where it is.
    pub place: String,
    /// Complete breaths recorded.
    pub breaths: usize,
    /// Connections that the recording took.
    pub sessions: u32,
    /// Figures of its recording and simulator.
    pub figures: Option<UnitFigures>,
    /// Its calibration.
    pub calibration: Option<Calibration>,
    /// Changes of its calibration over time.
    pub drift: Option<Drift>,
    /// Weights that run on it, verified.
    pub weights_id: Option<String>,
    /// Why it was left out.
    pub problem: Option<String>,
}

/// A farm after a run.
#[derive(Clone, Debug, Serialize)]
pub struct FarmResult {
    /// The units, in the order of the description.
    pub units: Vec<UnitResult>,
    /// Numbers outside the farm's band.
    pub outside: Vec<Outside>,
    /// Every controller on every unit, once that stage is complete.
    pub matrix: Option<Matrix>,
    /// Best single PID and reference bounds, if all units are virtual.
    pub rivals: Option<Rivals>,
}

/// A unit during a run.
struct Worker<'a> {
    unit: &'a Unit,
    contact: Contact,
    folder: Workspace,
    /// Why later stages leave it out.
    problem: Option<String>,
}

impl FarmRun<'_> {
    /// Runs the stages. A unit that fails is in the result; the error is that of the whole farm.
    ///
    /// # Errors
    /// A unit that answers as another one, before anything has moved; a folder of another farm; a stage that cannot run at all.
    pub fn run(&self, progress: &Progress<'_>) -> Result<FarmResult> {
        let folder = Workspace::new(&self.out);
        self.claim(&folder)?;
        let mut workers = self.workers(&folder)?;
        self.contact(&mut workers)?;
        let mut result = FarmResult { units: Vec::new(), outside: Vec::new(), matrix: None, rivals: None };
        if self.until >= FarmStage::Collect {
            self.on_all(&mut workers, |worker| self.collect(worker, progress));
        }
        if self.until >= FarmStage::Fit && !progress.stopped() {
            result.outside = self.fit(&folder, &mut workers, progress)?;
        }
        if self.until >= FarmStage::Train && !progress.stopped() && !self.recalibrate {
            let controllers = self.train(&folder, &workers, progress)?;
            if self.until >= FarmStage::Crosswise && !progress.stopped() {
                result.rivals = self.rivals(&folder, &workers, progress)?;
                let found = self.crosswise(&controllers, result.rivals.as_ref(), &mut workers, progress)?;
                if self.until >= FarmStage::Flash {
                    self.on_all(&mut workers, |worker| self.flash(worker, &found.images, progress));
                }
                result.matrix = Some(found.matrix);
            }
        }
        result.units = workers.iter().map(Worker::result).collect::<Result<_, _>>()?;
        Ok(result)
    }

    /// The units with their folders and, for virtual ones, their devices.
    fn workers(&self, folder: &Workspace) -> Result<Vec<Worker<'_>>> {
        let worker = |unit| {
            let contact = Contact::new(unit, self.pace)?;
            let folder = folder.folder(&format!("units/{}", unit.name));
            Ok(Worker { unit, contact, folder, problem: None })
        };
        self.farm.units.iter().map(worker).collect()
    }

    /// Works on all units at once that have no problem. A unit that fails is left out from then on; the rest goes on.
    fn on_all(&self, workers: &mut [Worker<'_>], work: impl Fn(&Worker<'_>) -> Result<()> + Sync) {
        let (threads, healthy) =
            (workers.len(), workers.iter_mut().filter(|worker| worker.problem.is_none()));
        let Ok(()) = on_threads(threads, healthy, |worker| {
            if let Err(error) = work(worker) {
                let problem = error.to_string();
                if !matches!(error, StudyError::Stopped) {
                    (self.tell)(&worker.unit.name, &problem);
                }
                worker.problem = Some(problem);
            }
            Ok::<_, Infallible>(())
        });
    }
}

impl Worker<'_> {
    fn result(&self) -> Result<UnitResult> {
        let state = self.state()?;
        Ok(UnitResult {
            name: self.unit.name.clone(),
            place: self.unit.place.to_string(),
            breaths: self.breaths()?,
            sessions: state.sessions,
            figures: self.figures()?,
            calibration: state.calibrations.last().copied(),
            drift: Drift::of(&state.calibrations),
            weights_id: state.weights.clone().map(|weights| weights.stored),
            problem: self.problem.clone(),
        })
    }
}
