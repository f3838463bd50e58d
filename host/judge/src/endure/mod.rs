//! Endurance test: random patients at random machines, for hours. Ventilation must go on, and every alarm must be deserved.
//!
//! A [`patient`] is drawn from the seed and a number. Its stay ([`course`]) runs the control half of a device as on the chip
//! against the bench. The bench knows the truth ([`truth`]), by which alarms are judged ([`deserved`]) and missing ones are found
//! ([`missed`]). Patients are independent, so the result depends neither on the number of threads nor on where an earlier
//! test was stopped.

pub mod course;
pub mod deserved;
pub mod efforts;
pub mod missed;
pub mod patient;
pub mod sensor_truth;
pub mod tally;
#[cfg(test)]
mod tests;
pub mod truth;

use std::io;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::pid::Pid;
use thiserror::Error;

use course::Observer;
use data::files::{read_json, write_json};
use patient::Patient;
use progress::{Progress, Stage, Task};
use tally::{PatientResult, Summary};
use ventilator::SourceError;

use crate::faults::hostile::SOUND;

/// Patients per thread between two saves.
const BATCH: usize = 4;

/// Why an endurance test cannot continue.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum EndureError {
    /// A stay failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The progress file could not be used.
    #[error("cannot use {}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// The file belongs to another test.
    #[error(
        "{} belongs to seed {seed}, {hours} h per patient and the controller {controller}: choose another file, or the \
         same options", path.display()
    )]
    OtherTest { path: PathBuf, seed: u64, hours: f64, controller: String },
}

/// An endurance test: what it is about, and the results so far. When saved, it can continue later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Endurance {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Stay of each patient, h.
    pub hours: f64,
    /// Name of the controller.
    pub controller: String,
    /// Results of the patients whose stay has ended, in their order.
    pub results: Vec<PatientResult>,
}

/// The PID that is best for all the paper's lungs, as in the fault matrix; its name.
///
/// # Errors
/// None in practice: the gains are valid.
pub fn sound_controller() -> Result<(Controller, String), SourceError> {
    let pid = Pid::new(SOUND, DEFAULT_PERIOD_US).map_err(|_| SourceError::Stopped)?;
    Ok((Controller::Pid(pid), format!("PID {},{},{}", SOUND.p, SOUND.i, SOUND.d)))
}

impl Endurance {
    /// A test at its beginning.
    pub fn new(seed: u64, hours: f64, controller: &str) -> Self {
        Self { seed, hours, controller: controller.to_owned(), results: Vec::new() }
    }

    /// The same test as a file has kept it, or unchanged if there is no such file.
    ///
    /// # Errors
    /// A file that cannot be read, or that belongs to another test.
    pub fn resumed(self, file: &Path) -> Result<Self, EndureError> {
        let Some(kept) = read_json::<Self>(file).map_err(failure(file))? else { return Ok(self) };
        let Self { seed, hours, controller, .. } = &kept;
        if (*seed, hours.to_bits(), controller) == (self.seed, self.hours.to_bits(), &self.controller) {
            return Ok(kept);
        }
        let (path, Self { seed, hours, controller, .. }) = (file.to_owned(), kept);
        Err(EndureError::OtherTest { path, seed, hours, controller })
    }

    /// Continues until this number of patients is done or it is stopped, and saves the results if a file is given. Stays
    /// that are stopped before their end start from their beginning the next time.
    ///
    /// # Errors
    /// A stay that fails, or a file that cannot be written.
    pub fn advance(
        &mut self,
        patients: u64,
        controller: &Controller,
        keep: Option<&Path>,
        progress: &Progress<'_>,
    ) -> Result<(), EndureError> {
        let minutes = |patients: u64| (patients as f64 * self.hours * 60.0).round() as usize;
        let task = progress.task(Stage::Endure, minutes(patients));
        let done = self.results.iter().filter(|result| result.patient < patients).count();
        task.reach(minutes(done as u64));
        let (seed, hours) = (self.seed, self.hours);
        let open: Vec<u64> = (0..patients).filter(|number| !self.has(*number)).collect();
        for batch in open.chunks(BATCH * rayon::current_num_threads()) {
            if task.stopped() {
                break;
            }
            let stays: Result<Vec<_>, SourceError> = batch
                .par_iter()
                .map(|number| {
                    let patient = Patient::draw(seed, *number, hours);
                    course::run(&patient, controller, hours, &mut Minutes(&task))
                })
                .collect();
            self.results.extend(stays?.into_iter().flatten());
            self.results.sort_by_key(|result| result.patient);
            let done = self.results.iter().filter(|result| result.patient < patients).count();
            task.reach(minutes(done as u64));
            if let Some(file) = keep {
                write_json(file, self).map_err(failure(file))?;
            }
        }
        Ok(())
    }

    fn has(&self, number: u64) -> bool {
        self.results.binary_search_by_key(&number, |result| result.patient).is_ok()
    }

    /// The results of the first patients together.
    pub fn summary(&self, patients: u64) -> Summary {
        let count = self.results.partition_point(|result| result.patient < patients);
        Summary::of(&self.results[..count])
    }
}

/// Reports minutes, and ends a stay on request.
struct Minutes<'a>(&'a Task<'a>);

impl Observer for Minutes<'_> {
    fn minute(&mut self) -> bool {
        self.0.advance(1);
        !self.0.stopped()
    }
}

fn failure(file: &Path) -> impl FnOnce(io::Error) -> EndureError {
    let path = file.to_owned();
    move |source| EndureError::File { path, source }
}
