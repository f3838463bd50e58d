//! Shared by the experiments: the folder for their results, and the progress callback.

use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use super::reproduction::{Budget, Reproduction};
use crate::error::{PaperError, Result};
use data::files::{claim, read_json, write_json_indented};
use learn::controller::learned::Learned;
use plant::bench::BenchConfig;
use progress::Progress;
use score::evaluate::{Evaluation, Plan, evaluate};

/// The lungs, budgets and folder of a reproduction.
pub(super) struct Study<'a> {
    pub(super) reproduction: &'a Reproduction,
    pub(super) progress: Progress<'a>,
}

/// The settings that must match for results to be comparable.
#[derive(PartialEq, Serialize, Deserialize)]
struct Claim {
    seed: u64,
    budget: Budget,
    lungs: Vec<BenchConfig>,
}

impl<'a> Study<'a> {
    /// Claims the folder, unless it belongs to another study.
    pub(super) fn new(reproduction: &'a Reproduction, progress: &Progress<'a>) -> Result<Self> {
        let Reproduction { seed, budget, lungs, out, .. } = reproduction;
        let own = Claim { seed: *seed, budget: budget.clone(), lungs: lungs.clone() };
        if claim(out, &own).map_err(PaperError::file(out))? {
            Ok(Self::unclaimed(reproduction, progress))
        } else {
            Err(PaperError::OtherRun(out.display().to_string()))
        }
    }

    /// The study in a folder that may belong to any; nothing is read or written.
    pub(super) fn unclaimed(reproduction: &'a Reproduction, progress: &Progress<'a>) -> Self {
        Self { reproduction, progress: *progress }
    }

    /// The lungs to train on.
    pub(super) fn lungs(&self) -> &'a [BenchConfig] {
        &self.reproduction.lungs
    }

    /// Index of the middle lung of the list, used by experiments on a single lung.
    pub(super) fn middle(&self) -> usize {
        self.lungs().len() / 2
    }

    /// A file or folder within the study's folder.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.reproduction.out.join(name)
    }

    /// The evaluation plan; all controllers meet the same sensor noise.
    pub(super) fn plan(&self) -> Plan {
        Plan::evaluation(self.reproduction.seed)
    }

    /// Scores a controller on a bench.
    pub(super) fn evaluate(&self, bench: &BenchConfig, controller: &Controller) -> Result<Evaluation> {
        Ok(evaluate(bench, controller, &self.plan())?)
    }

    /// A PID at the plan's control period.
    pub(super) fn pid(&self, gains: PidGains) -> Result<Controller> {
        Ok(Controller::Pid(Pid::new(gains, self.plan().period_us)?))
    }

    /// The controller trained in this subfolder of the study.
    pub(super) fn learned(&self, folder: &str) -> Result<Controller> {
        let learned = Learned::load(&self.path(folder).join("controller.safetensors"))?;
        Ok(Controller::Residual(learned.controller))
    }

    /// The result kept under this name, or that of `work`, which is then kept.
    pub(super) fn keep<T: Serialize + DeserializeOwned>(
        &self,
        name: &str,
        work: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        if let Some(kept) = self.kept(name)? {
            return Ok(kept);
        }
        let result = work()?;
        if self.progress.stopped() {
            return Err(PaperError::Stopped);
        }
        self.write(&format!("{name}.json"), &result)?;
        Ok(result)
    }

    /// The result kept under this name.
    pub(super) fn kept<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>> {
        let path = self.path(&format!("{name}.json"));
        read_json(&path).map_err(PaperError::file(&path))
    }

    /// Writes a value as JSON.
    pub(super) fn write(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let path = self.path(name);
        write_json_indented(&path, value).map_err(PaperError::file(&path))
    }
}
