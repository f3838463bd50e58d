//! Shared by the experiments: the folder for their results, their budgets, and the progress callback.

use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use super::Reproduction;
use crate::error::{PaperError, Result};
use data::files::{claim, read_json, write_json_indented};
use laws::rl::compare::RlConfig;
use learn::controller::learned::Learned;
use learn::pipeline::PipelineConfig;
use plant::bench::BenchConfig;
use progress::Progress;
use score::baselines::{Grid, Search};
use score::evaluate::{Evaluation, Plan, evaluate};

/// Repeats and sizes of the experiments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Budget {
    /// Number of controllers trained for each lung, under different seeds.
    pub repeats: u64,
    /// Search for the best PIDs.
    pub search: Search,
    /// Rounds of collect, fit and train for one lung; seed and gains are replaced.
    pub lung: PipelineConfig,
    /// Rounds of collect, fit and train for all lungs at once.
    pub generalist: PipelineConfig,
    /// The pipeline that the ablations vary.
    pub ablation: PipelineConfig,
    /// Configuration of PPO and DQN; the seed is replaced.
    pub learners: RlConfig,
    /// Breaths from rest before the rivals are scored a second time: some of them learn from breath to breath.
    pub breaths_of_learning: usize,
}

impl Budget {
    /// The budget of the published results.
    pub fn full() -> Self {
        let lung = PipelineConfig::default();
        let mut generalist = PipelineConfig { ensemble: 1, ..lung.clone() };
        generalist.collect.breaths = 60;
        generalist.train.iterations = 1200;
        let ablation = PipelineConfig { rounds: 1, ..lung.clone() };
        let (search, learners) = (Search::default(), RlConfig::default());
        Self { repeats: 2, search, lung, generalist, ablation, learners, breaths_of_learning: 20 }
    }

    /// A small budget: the same trends in a few minutes.
    pub fn quick() -> Self {
        let mut lung = PipelineConfig { rounds: 1, ensemble: 1, ..PipelineConfig::default() };
        lung.collect.breaths = 60;
        lung.fit.epochs /= 2;
        lung.train.iterations = 250;
        let mut generalist = PipelineConfig { rounds: 2, ..lung.clone() };
        generalist.collect.breaths = 40;
        let mut ablation = lung.clone();
        ablation.collect.breaths = 40;
        ablation.fit.epochs /= 2;
        ablation.train.iterations = 120;
        let search = Search { grid: Grid::coarse(), refinements: 2, ..Search::default() };
        let learners = RlConfig { ppo_samples: 2_000_000, dqn_samples: 1_000_000, ..RlConfig::default() };
        Self { repeats: 1, search, lung, generalist, ablation, learners, breaths_of_learning: 6 }
    }
}

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
