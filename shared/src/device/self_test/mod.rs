//! The self-test: what must be in order before ventilation starts.
//!
//! | step | when | what it needs |
//! |---|---|---|
//! | program, weights, memory | at the start of the chip | nothing |
//! | sensors | in standby after the start, until it has passed once | no patient at the machine |
//! | zero | on request | both pressure sensors open to the air |
//! | valves, circuit | on request | a test lung at the patient port |
//! | relief | on request | a closed patient port |
//!
//! A step that fails, or that must run and has not ended, prevents a start with [`Refusal::SelfTestFailed`] or
//! [`Refusal::SelfTestRuns`]. A step on request that was never asked for prevents nothing. A ventilation that a reset has
//! interrupted resumes without waiting for any of them: no finding here is worse than no ventilation.
//!
//! The zeros that the step *zero* measures are subtracted from all later readings until the device restarts.

mod manoeuvre;
pub mod memory;
mod rest;

use crate::link::refusal::Refusal;
pub use crate::link::self_test::{Check, Finding, Outcome, Report, Step, StepResult};
use crate::safety::filter::ValveCommand;
use crate::sensor::Readings;
use crate::settings::Settings;
use crate::weights::slots::SlotState;
use manoeuvre::{Manoeuvre, Progress};
use rest::Rest;

/// What the start of the chip has found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BootFindings {
    /// Whether the program matches its checksum; none if the image has no checksum.
    pub program: Option<bool>,
    /// Whether RAM keeps its content; none if it was not tested.
    pub memory: Option<bool>,
    /// State of both weights slots.
    pub slots: [SlotState; 2],
}

/// What runs now.
#[derive(Clone, Copy, Debug)]
enum Running {
    Nothing,
    Rest(Rest),
    Zero(Rest),
    Manoeuvre(Manoeuvre),
}

/// The self-test of a device. Fulfils: self-test.
#[derive(Clone, Debug)]
pub struct SelfTest {
    period_us: u32,
    results: [StepResult; Step::ALL.len()],
    activity: Running,
    /// What the pressure sensors read at the pressure of the air, cmH2O: airway, outlet.
    zero: [f32; 2],
}

impl SelfTest {
    /// A self-test that prevents no start: every step counts as not run, and none has to.
    pub fn none(period_us: u32) -> Self {
        let results = [StepResult::from(Outcome::NotRun); Step::ALL.len()];
        Self { period_us, results, activity: Running::Nothing, zero: [0.0; 2] }
    }

    /// The self-test after a start of the chip; the step [`Step::Sensors`] runs from the first tick on.
    pub fn after_boot(period_us: u32, boot: &BootFindings) -> Self {
        let mut test = Self::none(period_us);
        let judged = |sound: Option<bool>, finding| match sound {
            None => Outcome::NotRun,
            Some(true) => Outcome::Passed,
            Some(false) => Outcome::Failed(finding),
        };
        // A store that was cut short leaves a torn slot and takes nothing away: an alarm reports it.
        // Weights of another layout or owner do not run, but are no sign of a fault either.
        let damaged =
            boot.slots.iter().any(|slot| matches!(slot, SlotState::Invalid(problem) if problem.is_damage()));
        test.set(Step::Program, judged(boot.program, Finding::Program));
        test.set(Step::Weights, judged(Some(!damaged), Finding::Weights));
        test.set(Step::Memory, judged(boot.memory, Finding::Memory));
        test.set(Step::Sensors, Outcome::Runs);
        test.activity = Running::Rest(Rest::new(period_us));
        test
    }

    fn set(&mut self, step: Step, result: impl Into<StepResult>) {
        self.results[step as usize % Step::ALL.len()] = result.into();
    }

    /// The results of all steps.
    pub fn report(&self) -> Report {
        self.results.iter().copied().collect()
    }

    /// Whether ventilation may start.
    ///
    /// # Errors
    /// [`Refusal::SelfTestFailed`] with the first failed step; [`Refusal::SelfTestRuns`].
    pub fn permit(&self) -> Result<(), Refusal> {
        for (step, result) in Step::ALL.into_iter().zip(&self.results) {
            if let Outcome::Failed(finding) = result.outcome {
                return Err(Refusal::SelfTestFailed { step, finding });
            }
        }
        if self.results.iter().any(|result| result.outcome == Outcome::Runs) {
            return Err(Refusal::SelfTestRuns);
        }
        Ok(())
    }

    /// Begins a check. The step [`Step::Sensors`], if it has not passed, runs again after it.
    ///
    /// # Errors
    /// [`Refusal::SelfTestRuns`] while another check runs.
    pub fn begin(&mut self, check: Check) -> Result<(), Refusal> {
        if let Running::Zero(_) | Running::Manoeuvre(_) = self.activity {
            return Err(Refusal::SelfTestRuns);
        }
        debug_assert!(!self.moves_valves());
        self.activity = match check {
            Check::Zero => {
                self.set(Step::Zero, Outcome::Runs);
                Running::Zero(Rest::new(self.period_us))
            }
            Check::Circuit => {
                self.set(Step::Valves, Outcome::Runs);
                self.set(Step::Circuit, Outcome::NotRun);
                Running::Manoeuvre(Manoeuvre::circuit())
            }
            Check::Relief => {
                self.set(Step::Relief, Outcome::Runs);
                Running::Manoeuvre(Manoeuvre::relief())
            }
        };
        Ok(())
    }

    /// Ends a running check without a result.
    pub fn abort(&mut self) {
        if let Running::Zero(_) | Running::Manoeuvre(_) = self.activity {
            self.cancel(Outcome::NotRun);
        }
    }

    /// Whether a check moves the valves.
    pub fn moves_valves(&self) -> bool {
        matches!(self.activity, Running::Manoeuvre(_))
    }

    #[cold]
    fn cancel(&mut self, outcome: Outcome) {
        for step in [Step::Zero, Step::Valves, Step::Circuit, Step::Relief] {
            if self.results[step as usize].outcome == Outcome::Runs {
                self.set(step, outcome);
            }
        }
        self.finish();
    }

    /// Ends the running activity.
    fn finish(&mut self) {
        let ended = |step: &Step| self.results[*step as usize].outcome != Outcome::Runs;
        debug_assert!([Step::Zero, Step::Valves, Step::Circuit, Step::Relief].iter().all(ended));
        let passed =
            matches!(self.results[Step::Sensors as usize].outcome, Outcome::Passed | Outcome::NotRun);
        self.activity = if passed { Running::Nothing } else { Running::Rest(Rest::new(self.period_us)) };
    }

    /// The readings without the sensors' zeros.
    #[inline]
    pub fn zeroed(&self, readings: Readings) -> Readings {
        let [airway, outlet] = self.zero;
        Readings { airway: readings.airway - airway, outlet: readings.outlet - outlet, ..readings }
    }

    /// Forgets the airway sensor's zero, when a calibration replaces it.
    pub fn forget_airway_zero(&mut self) {
        self.zero[0] = 0.0;
    }

    /// Runs a tick in standby with readings without their zeros; returns a command if the test moves the valves. `alarm`: an alarm
    /// begins in this tick.
    #[inline]
    pub fn step(&mut self, readings: &Readings, settings: &Settings, alarm: bool) -> Option<ValveCommand> {
        match self.activity {
            Running::Nothing => None,
            _ => self.run(readings, settings, alarm),
        }
    }

    #[inline(never)]
    fn run(&mut self, readings: &Readings, settings: &Settings, alarm: bool) -> Option<ValveCommand> {
        match &mut self.activity {
            Running::Nothing => {}
            Running::Rest(rest) => {
                if let Some(seen) = rest.add(readings) {
                    let result = seen.judge(settings.peep);
                    self.set(Step::Sensors, result);
                    self.finish();
                }
            }
            Running::Zero(rest) => {
                if let Some(seen) = rest.add(readings) {
                    let (result, change) = seen.zero(self.zero);
                    self.zero = change;
                    self.set(Step::Zero, result);
                    self.finish();
                }
            }
            Running::Manoeuvre(_) if alarm => self.cancel(Outcome::Failed(Finding::Alarm)),
            Running::Manoeuvre(manoeuvre) => {
                let period_us = self.period_us;
                let progress = manoeuvre.step(readings, period_us);
                return self.manoeuvred(progress);
            }
        }
        None
    }

    fn manoeuvred(&mut self, progress: Progress) -> Option<ValveCommand> {
        match progress {
            Progress::Command(command) => return Some(command),
            Progress::Circuit { valves, circuit } => {
                self.set(Step::Valves, valves);
                self.set(Step::Circuit, circuit);
            }
            Progress::Relief(result) => self.set(Step::Relief, result),
        }
        self.finish();
        None
    }
}

#[cfg(test)]
mod tests;
