//! One lung each (the paper's performance): the best PID of a search on that very bench against the controller trained on
//! the simulator learned for that lung.

use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::PidGains;

use super::Reproduction;
use super::study::Study;
use crate::StudyError;
use judge::baselines::{Best, tune_pid};
use judge::evaluate::{Evaluation, Plan};
use learn::pipeline::{self, Folder, MakeSource, Outcome, PipelineConfig, Stage};
use plant::bench::BenchConfig;
use ventilator::{BenchSource, Source, SourceError};

/// The best PIDs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct TunedPids {
    /// By lung.
    pub(super) lungs: Vec<Best>,
    /// For all of them.
    pub(super) over_all: Best,
}

/// What became of a lung.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct LungScores {
    /// Its own best PID.
    pub(super) pid: Evaluation,
    /// The best PID for all lungs.
    pub(super) single_pid: Evaluation,
    /// The controllers learned for it, by seed.
    pub(super) learned: Vec<Evaluation>,
    /// Open-loop distance of each learned simulator that was kept, cmH2O.
    pub(super) open_loop: Vec<f64>,
    /// Control ticks recorded for each controller.
    pub(super) ticks: Vec<usize>,
}

/// Searches the PIDs.
pub(super) fn tuned(study: &Study<'_>) -> Result<TunedPids, StudyError> {
    study.keep("tuning", || {
        let Reproduction { seed, budget, .. } = study.reproduction;
        let progress = |done, total| (study.observer)("search PIDs", done as usize, total as usize);
        let plan = Plan::tuning(*seed);
        let result = tune_pid(study.lungs(), &budget.search, &plan, &progress, study.stop)?;
        if !result.complete {
            return Err(StudyError::Stopped);
        }
        let lungs = result.lungs.into_iter().map(|lung| lung.best).collect();
        Ok(TunedPids { lungs, over_all: result.over_all })
    })
}

/// Trains and scores a controller for each lung.
pub(super) fn lungs(study: &Study<'_>) -> Result<Vec<LungScores>, StudyError> {
    let tuned = tuned(study)?;
    let lungs = study.lungs().iter().zip(&tuned.lungs);
    lungs
        .map(|(bench, best)| {
            study.keep(&format!("lungs/{}", bench.name), || {
                lung(study, bench, best.pid.gains, tuned.over_all.pid.gains)
            })
        })
        .collect()
}

/// All that the folder holds, if it holds every lung.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Vec<LungScores>>, StudyError> {
    study.lungs().iter().map(|bench| study.kept(&format!("lungs/{}", bench.name))).collect()
}

fn lung(
    study: &Study<'_>,
    bench: &BenchConfig,
    own: PidGains,
    single: PidGains,
) -> Result<LungScores, StudyError> {
    let Reproduction { seed, budget, .. } = study.reproduction;
    let (mut learned, mut open_loop, mut ticks) = (Vec::new(), Vec::new(), Vec::new());
    for repeat in 0..budget.repeats {
        let config = PipelineConfig { gains: own, seed: seed + repeat, ..budget.lung.clone() };
        let folder = format!("lungs/{}-{repeat}", bench.name);
        let outcome = train(study, std::slice::from_ref(bench), &config, &folder)?;
        learned.push(study.evaluate(bench, &Controller::Residual(outcome.learned.controller.clone()))?);
        let last = outcome.rounds.last().and_then(|round| round.open_loop.first());
        open_loop.extend(last.map(|distance| distance.truth.unwrap_or(distance.measured)));
        ticks.push(outcome.plants.iter().map(|plant| plant.recording.len()).sum());
    }
    let (pid, single_pid) = (study.pid(own)?, study.pid(single)?);
    Ok(LungScores {
        pid: study.evaluate(bench, &pid)?,
        single_pid: study.evaluate(bench, &single_pid)?,
        learned,
        open_loop,
        ticks,
    })
}

/// Collects from benches, fits simulators to each and trains one controller on all of them, in a folder of the study's.
pub(super) fn train(
    study: &Study<'_>,
    benches: &[BenchConfig],
    config: &PipelineConfig,
    folder: &str,
) -> Result<Outcome, StudyError> {
    let base = study.pid(config.gains)?;
    let make: Vec<_> = benches
        .iter()
        .map(|bench| {
            |seed| -> Result<Box<dyn Source>, SourceError> {
                let settings = &config.collect.settings;
                Ok(Box::new(BenchSource::new(bench, base.clone(), settings, config.period_us, seed)?))
            }
        })
        .collect();
    let sources: Vec<MakeSource<'_>> = make.iter().map(|make| make as MakeSource<'_>).collect();
    train_on(study, &sources, config, folder)
}

/// The same on any plants.
pub(super) fn train_on(
    study: &Study<'_>,
    sources: &[MakeSource<'_>],
    config: &PipelineConfig,
    folder: &str,
) -> Result<Outcome, StudyError> {
    let observer = |round: usize, stage: Stage, done, total| {
        let stage = match stage {
            Stage::Collect => "collect",
            Stage::Fit => "fit",
            Stage::Train => "train",
        };
        (study.observer)(&format!("{folder} {}: {stage}", round + 1), done, total);
    };
    let run = Folder::new(study.path(folder));
    let outcome = pipeline::run(config, sources, Some(&run), &observer, study.stop)?;
    if !outcome.complete {
        return Err(StudyError::Stopped);
    }
    outcome.learned.save(&study.path(folder).join("controller.safetensors"))?;
    Ok(outcome)
}
