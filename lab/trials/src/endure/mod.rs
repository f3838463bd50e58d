//! Endurance test: random patients at random machines, for hours. Ventilation must go on, and every alarm must be deserved.
//!
//! A [`patient`] is drawn from the seed and a number. Its stay ([`course`]) runs the control half of a device as on the chip
//! against the bench. The bench knows the truth ([`truth`]), by which alarms are judged ([`deserved`]) and missing ones are found
//! ([`missed`]). Patients are independent, so the result depends neither on the number of threads nor on where an earlier
//! test was stopped.

mod behaviour;
mod chance;
pub mod course;
pub mod deserved;
pub mod efforts;
pub mod flow_truth;
pub mod missed;
mod operator;
pub mod patient;
mod ramp;
pub mod sensor_truth;
mod slow_fault;
pub mod tally;
#[cfg(test)]
mod tests;
pub mod truth;
mod ward;

use serde::{Deserialize, Serialize};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::pid::Pid;
use thiserror::Error;

use campaign::{Sums, Work, WorkspaceError};
use course::Observer;
use patient::Patient;
use progress::{Stage, Task};
use tally::{PatientResult, Summary};
use ventilator::SourceError;

use crate::faults::hostile::SOUND;

/// Random patients: minutes of their stays.
pub const ENDURE: Stage = Stage("endure, minutes");

/// Why an endurance test cannot continue.
#[derive(Debug, Error)]
pub enum EndureError {
    /// A stay failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The test cannot be kept or continued.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
}

/// The PID that is best for all the paper's lungs, as in the fault matrix; its name.
///
/// # Errors
/// None in practice: the gains are valid.
pub fn sound_controller() -> Result<(Controller, String), SourceError> {
    let pid = Pid::new(SOUND, DEFAULT_PERIOD_US).map_err(|_| SourceError::Stopped)?;
    Ok((Controller::Pid(pid), format!("PID {},{},{}", SOUND.p, SOUND.i, SOUND.d)))
}

/// What an endurance test is about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Question {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Stay of each patient, h.
    pub hours: f64,
    /// Name of the controller.
    pub controller: String,
}

/// An endurance test; its units are the patients.
#[derive(Clone, Debug)]
pub struct Endurance<'a> {
    /// What it is about.
    pub question: Question,
    /// The controller.
    pub controller: &'a Controller,
}

impl Work for Endurance<'_> {
    type Question = Question;
    type Sums = Stays;
    type Error = EndureError;

    fn question(&self) -> Question {
        self.question.clone()
    }

    fn nothing(&self) -> Stays {
        Stays::default()
    }

    fn stage(&self) -> (Stage, f64) {
        (ENDURE, self.question.hours * 60.0)
    }

    /// A stay that is stopped before its end starts from its beginning the next time.
    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<PatientResult>, EndureError> {
        let Question { seed, hours, .. } = self.question;
        let patient = Patient::draw(seed, number, hours);
        Ok(course::run(&patient, self.controller, hours, &mut Minutes(task))?)
    }
}

/// Results of the patients whose stay has ended, in their order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Stays(Vec<PatientResult>);

impl Stays {
    /// The results of the first patients together.
    pub fn summary(&self, patients: u64) -> Summary {
        let count = self.0.partition_point(|result| result.patient < patients);
        Summary::of(&self.0[..count])
    }
}

impl Sums for Stays {
    type Unit = PatientResult;

    fn add(&mut self, _: u64, result: PatientResult) {
        let place = self.0.partition_point(|other| other.patient < result.patient);
        self.0.insert(place, result);
    }

    fn absorb(&mut self, other: Self) {
        self.0.extend(other.0);
        self.0.sort_by_key(|result| result.patient);
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
