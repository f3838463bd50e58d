//! The experiments, their budgets, and the configuration of a reproduction.

use std::path::PathBuf;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use laws::rl::compare::RlConfig;
use learn::pipeline::PipelineConfig;
use plant::bench::BenchConfig;
use score::baselines::{Grid, Search};

/// An experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
pub enum Experiment {
    /// The best P, I and PID for each lung and for all lungs
    Tuning,
    /// A learned controller for each lung
    Lungs,
    /// One learned controller for all lungs
    Generalist,
    /// A reference bound per lung: commands optimised on a fully known bench
    Bound,
    /// Curves of all controllers on one lung
    Tracking,
    /// Lungs and ventilators not used in training
    Unseen,
    /// Controllers for a whole family of plants, and laws from the literature
    Rivals,
    /// A lung that changes between two breaths
    Changes,
    /// The pressure-control rows of the test table
    Iso,
    /// The authors' own plant, beside their figures
    Balloon,
    /// PPO and DQN on the learned simulators of one lung
    Rl,
    /// The contribution of each part of the system, on one lung
    Ablations,
}

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

/// Configuration of a reproduction.
#[derive(Clone, Debug)]
pub struct Reproduction {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Repeats and sizes of the experiments.
    pub budget: Budget,
    /// The lungs to train on.
    pub lungs: Vec<BenchConfig>,
    /// Folder for all results.
    pub out: PathBuf,
    /// The experiments to run; those they depend on run as well.
    pub only: Vec<Experiment>,
}
