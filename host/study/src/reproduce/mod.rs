//! The paper's experiments on the virtual bench, and those that go beyond it (Suo et al. 2021, section 6).
//!
//! [`run`] carries out experiments one after the other. Each keeps its result as JSON in the folder, so that a stopped run
//! goes on where it was and an experiment finds what an earlier one has left. At the end all results found there become
//! `results.json` and one report.

mod ablations;
mod balloon;
mod changes;
mod generalist;
mod iso;
mod learning;
mod limits;
mod lungs;
mod report;
mod results;
mod study;
#[cfg(test)]
mod tests;
mod tracking;
mod unseen;

use std::path::PathBuf;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::error::Result;
use plant::bench::BenchConfig;
use progress::Progress;

pub use ablations::Ablation;
pub use report::{headline, lungs_table};
pub use results::{
    BalloonFigures, IsoFigures, LungFigures, LungMeans, Results, RlFigure, RlFigures, UnseenFigures,
};
pub use study::Budget;
use study::Study;

/// An experiment, in the order in which they are run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
pub enum Experiment {
    /// The best P, I and PID for each lung and for all of them
    Tuning,
    /// A learned controller for each lung
    Lungs,
    /// One learned controller for all lungs
    Generalist,
    /// What no controller can beat: the best commands for a bench that is known in every detail
    Bound,
    /// Curves of all controllers on one lung
    Tracking,
    /// Lungs and ventilators outside of the training
    Unseen,
    /// A lung that changes from one breath to the next
    Changes,
    /// The pressure-control rows of the test table
    Iso,
    /// The authors' own plant, side by side with their figures
    Balloon,
    /// PPO and DQN on the learned simulators of one lung
    Rl,
    /// What each part of the system is worth, on one lung
    Ablations,
}

/// What to run.
#[derive(Clone, Debug)]
pub struct Reproduction {
    /// Seed of everything.
    pub seed: u64,
    /// How much to spend.
    pub budget: Budget,
    /// The lungs to train on.
    pub lungs: Vec<BenchConfig>,
    /// Folder of all results.
    pub out: PathBuf,
    /// Which experiments; those that they need are run as well.
    pub only: Vec<Experiment>,
}

/// Runs the experiments, then writes everything that the folder holds as `results.json`, `report.html` and `results.md`.
///
/// # Errors
/// The first experiment that fails; what earlier ones left stays.
pub fn run(reproduction: &Reproduction, progress: &Progress<'_>) -> Result<Results> {
    let study = Study::new(reproduction, progress)?;
    for experiment in Experiment::value_variants().iter().filter(|e| reproduction.only.contains(e)) {
        match experiment {
            Experiment::Tuning => drop(lungs::tuned(&study)?),
            Experiment::Lungs => drop(lungs::lungs(&study)?),
            Experiment::Generalist => drop(generalist::generalist(&study)?),
            Experiment::Bound => drop(limits::limits(&study)?),
            Experiment::Balloon => drop(balloon::balloon(&study)?),
            Experiment::Rl => drop(learning::learning(&study)?),
            Experiment::Ablations => drop(ablations::ablations(&study)?),
            Experiment::Tracking => drop(tracking::tracking(&study)?),
            Experiment::Unseen => drop(unseen::unseen(&study)?),
            Experiment::Changes => drop(changes::changes(&study)?),
            Experiment::Iso => drop(iso::iso(&study)?),
        }
    }
    let results = Results::gather(&study)?;
    study.write("results.json", &results)?;
    let report = report::report(&study, &results)?;
    report.save(study.path("report.html"))?;
    report.save_markdown(&reproduction.out, "results")?;
    Ok(results)
}
