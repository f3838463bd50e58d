//! A farm of one unit, which need not be a device: a bench or a third-party plant will do.
//!
//! It goes the way of a farm: recording, simulator, controller, comparison. But nothing is stored on the unit, and each stage is called
//! by itself.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::Pid;
use shared::control::residual::Residual;

use super::crosswise::plan;
use crate::error::Result;
use data::recording::Recording;
use data::workspace::Workspace;
use learn::pipeline::commission::{Checked, CommissionRun, Commissioned};
use learn::pipeline::{PipelineError, checksum};
use plant::bench::BenchConfig;
use progress::Progress;
use score::evaluate::{Plan, evaluate_law};
use ventilator::Source;
use ventilator::collect::{CollectError, collect};

/// Name of a recording that was stopped or failed.
const PARTIAL: &str = "recording.partial.parquet";
/// Numbers of breaths of learning before the scored breaths on a bench; with 0 the first breath from rest is scored alone.
const BREATHS_OF_LEARNING: [usize; 3] = [0, 1, 20];
/// Share by which a score on the bench must rise to count as worse.
const WORSE_BY: f64 = 0.01;

/// A farm of one unit.
pub struct Alone<'a> {
    /// Collection, fit and training.
    pub run: CommissionRun,
    /// The controller to start from.
    pub start: &'a Residual,
    /// Address of the unit, or description of the bench.
    pub unit: String,
    /// The bench, if the unit is one.
    pub bench: Option<BenchConfig>,
    /// Its folder.
    pub folder: Workspace,
}

/// The settings that must match to continue.
#[derive(Serialize, Deserialize)]
struct Claim {
    run: CommissionRun,
    /// Address of the unit, or description of the bench.
    unit: String,
    /// Checksum of the starting controller.
    start: u32,
}

/// Scores of the three controllers, cmH2O.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// Of the PID under the starting controller.
    pub pid: f64,
    /// Of the starting controller.
    pub start: f64,
    /// Of the commissioned controller.
    pub commissioned: f64,
}

/// Scores on the bench after this number of breaths of learning.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OnBench {
    /// Number of breaths before the scored ones.
    pub breaths_of_learning: usize,
    /// The scores.
    #[serde(flatten)]
    pub scores: Scores,
}

impl Scores {
    /// On the units drawn around the simulator.
    pub fn on_simulator(commissioned: &Commissioned) -> Self {
        let origin = &commissioned.learned.origin;
        Self { pid: origin.base, start: commissioned.start, commissioned: origin.validation }
    }

    /// Whether the commissioned controller is worse than the starting one.
    pub fn worse(&self) -> bool {
        self.commissioned > (1.0 + WORSE_BY) * self.start
    }
}

impl Alone<'_> {
    /// Claims the folder.
    ///
    /// # Errors
    /// The folder of another unit, seed, configuration or starting controller, or one that cannot be used.
    pub fn claim(&self) -> Result<()> {
        let start = checksum(self.start.network().parameters());
        Ok(self.folder.claim(&Claim { run: self.run.clone(), unit: self.unit.clone(), start })?)
    }

    /// Path of the recording, once it is complete.
    pub fn recording(&self) -> PathBuf {
        self.folder.path("recording.parquet")
    }

    /// The recording of an earlier call, if the folder has one that is complete.
    ///
    /// # Errors
    /// The folder of another unit, or a recording that cannot be read.
    pub fn recorded(&self) -> Result<Option<Recording>> {
        if !self.recording().exists() {
            return Ok(None);
        }
        self.claim()?;
        Ok(Some(Recording::load(self.recording())?))
    }

    /// Records the unit. A recording that was stopped or failed is kept under another name, and repeated by the next call.
    ///
    /// # Errors
    /// A unit that cannot be recorded, or a recording that was stopped.
    pub fn record(&self, source: &mut dyn Source, progress: &Progress<'_>) -> Result<Recording> {
        let pid = self.run.pid(source.period_us())?;
        let partial = self.folder.path(PARTIAL);
        let recording = match collect(source, &pid, &self.run.collection(0), progress) {
            Err(CollectError::Interrupted { reason, collected }) => {
                collected.recording.save(&partial)?;
                let (breaths, file) = (collected.breaths, partial.display().to_string());
                return Err(PipelineError::Interrupted { reason, breaths, file }.into());
            }
            outcome => outcome?.recording,
        };
        if progress.stopped() {
            if !recording.is_empty() {
                recording.save(&partial)?;
            }
            return Err(PipelineError::Stopped.into());
        }
        recording.save(self.recording())?;
        Ok(recording)
    }

    /// Trains the controller further on units around the simulator, or continues a training that was stopped.
    ///
    /// # Errors
    /// A controller or a checkpoint that is not valid.
    pub fn train(&self, checked: &Checked, progress: &Progress<'_>) -> Result<Commissioned> {
        Ok(self.run.tune(self.start, &[&checked.simulator], Some(&self.folder), progress)?)
    }

    /// Scores the controllers on the bench, if the unit is one, under noise that was not used before.
    ///
    /// # Errors
    /// A bench that is refused, or a wish to stop.
    pub fn compare(&self, learned: &Residual, progress: &Progress<'_>) -> Result<Vec<OnBench>> {
        let Some(bench) = &self.bench else { return Ok(Vec::new()) };
        let spec = self.start.spec();
        let pid = Controller::Pid(Pid::new(spec.gains, spec.period_us)?);
        let [start, learned] = [self.start, learned].map(|residual| Controller::Residual(residual.clone()));
        let after = |breaths_of_learning| {
            let scored = if breaths_of_learning == 0 { 1 } else { Plan::default().breaths };
            let plan = Plan { period_us: spec.period_us, ..plan(&self.run, breaths_of_learning, scored) };
            let score = |controller| -> Result<f64> {
                Ok(evaluate_law(bench, controller, &plan, progress)?.mean.score)
            };
            let (pid, start, commissioned) = (score(&pid)?, score(&start)?, score(&learned)?);
            Ok(OnBench { breaths_of_learning, scores: Scores { pid, start, commissioned } })
        };
        BREATHS_OF_LEARNING.into_iter().map(after).collect()
    }
}

#[cfg(test)]
mod tests;
