//! Shared by the experiments: the folder for their results, and the progress callback.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use super::reproduction::{Budget, Reproduction};
use data::workspace::Workspace;
use learn::controller::learned::Learned;
use plant::bench::BenchConfig;
use progress::Progress;
use score::evaluate::{Evaluation, Plan, evaluate};
use study::{Result, StudyError};

/// File of a controller in its folder.
pub(super) const CONTROLLER: &str = "controller.safetensors";

/// A piece of work that uses the result of no other piece and keeps its own in the study's folder.
pub(super) type Piece<'a> = Box<dyn Fn() -> Result<()> + Send + Sync + 'a>;

/// A piece of work whose result is needed only in the folder.
pub(super) fn piece<'a, T>(work: impl Fn() -> Result<T> + Send + Sync + 'a) -> Piece<'a> {
    Box::new(move || work().map(drop))
}

/// The lungs, budgets and folder of a reproduction.
pub(super) struct Study<'a> {
    pub(super) reproduction: &'a Reproduction,
    /// The folder for all results.
    pub(super) folder: Workspace,
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
        let Reproduction { seed, budget, lungs, .. } = reproduction;
        let study = Self::unclaimed(reproduction, progress);
        study.folder.claim(&Claim { seed: *seed, budget: budget.clone(), lungs: lungs.clone() })?;
        Ok(study)
    }

    /// The study in a folder that may belong to any; nothing is read or written.
    pub(super) fn unclaimed(reproduction: &'a Reproduction, progress: &Progress<'a>) -> Self {
        Self { reproduction, folder: Workspace::new(&reproduction.out), progress: *progress }
    }

    /// The lungs to train on.
    pub(super) fn lungs(&self) -> &'a [BenchConfig] {
        &self.reproduction.lungs
    }

    /// Index of the middle lung of the list, used by experiments on a single lung.
    pub(super) fn middle(&self) -> usize {
        self.lungs().len() / 2
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
        let learned = Learned::load(&self.folder.folder(folder).path(CONTROLLER))?;
        Ok(Controller::Residual(learned.controller))
    }

    /// The result kept under this name, or that of `work`, which is then kept.
    pub(super) fn keep<T: Serialize + DeserializeOwned>(
        &self,
        name: &str,
        work: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        self.folder.keep(&file_of(name), || {
            let result = work()?;
            if self.progress.stopped() { Err(StudyError::Stopped) } else { Ok(result) }
        })
    }

    /// The result kept under this name.
    pub(super) fn kept<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>> {
        Ok(self.folder.load(&file_of(name))?)
    }
}

/// The file of a result.
fn file_of(name: &str) -> String {
    format!("{name}.json")
}
