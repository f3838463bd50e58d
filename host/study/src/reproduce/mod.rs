//! The paper's experiments on the virtual bench, and further ones (Suo et al. 2021, section 6).
//!
//! [`run`] runs the experiments one after the other. Each keeps its result as JSON in the folder, so that a stopped run
//! can continue and experiments can use earlier results. At the end, all results in the folder are combined into
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

/// An experiment; the order is the order of execution.
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

/// Runs the experiments, then writes all results in the folder as `results.json`, `report.html` and `results.md`.
///
/// # Errors
/// The error of the first experiment that fails; results of earlier ones stay.
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
