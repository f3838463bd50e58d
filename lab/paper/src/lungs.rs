//! One controller per lung (the paper's performance experiment): the best PID found on the same bench against the
//! controller trained on the simulator learned for that lung.

use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::PidGains;

use super::Reproduction;
use super::study::{CONTROLLER, Piece, Study, piece};
use data::workspace::Workspace;
use learn::controller::Trainable;
use learn::pipeline::{self, Outcome, PipelineConfig, PipelineError};
use plant::bench::BenchConfig;
use progress::Progress;
use score::baselines::{Best, tune_pid};
use score::evaluate::{Evaluation, Plan};
use study::{Result, StudyError};

/// The best PIDs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct TunedPids {
    pub(super) lungs: Vec<Best>,
    pub(super) over_all: Best,
}

/// Results of one lung.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct LungScores {
    pub(super) pid: Evaluation,
    pub(super) single_pid: Evaluation,
    /// Evaluations of the controllers learned for the lung, by seed.
    pub(super) learned: Vec<Evaluation>,
    /// Open-loop distance of each learned simulator that was kept, cmH2O.
    pub(super) open_loop: Vec<f64>,
    /// Control ticks recorded for each controller.
    pub(super) ticks: Vec<usize>,
}

/// Searches the PIDs.
pub(super) fn tuned(study: &Study<'_>) -> Result<TunedPids> {
    study.keep("tuning", || {
        let Reproduction { seed, budget, .. } = study.reproduction;
        let plan = Plan::tuning(*seed);
        let result = tune_pid(study.lungs(), &budget.search, &plan, &study.progress)?;
        if !result.complete {
            return Err(StudyError::Stopped);
        }
        let lungs = result.lungs.into_iter().map(|lung| lung.best).collect();
        Ok(TunedPids { lungs, over_all: result.over_all })
    })
}

/// Training and scoring of controllers for each lung.
pub(super) fn pieces<'a>(study: &'a Study<'_>) -> Result<Vec<Piece<'a>>> {
    let tuned = tuned(study)?;
    let single = tuned.over_all.pid.gains;
    let of = |(bench, best): (&'a BenchConfig, &Best)| {
        let own = best.pid.gains;
        piece(move || study.keep(&place(bench), || lung(study, bench, own, single)))
    };
    Ok(study.lungs().iter().zip(&tuned.lungs).map(of).collect())
}

/// The kept results, if the folder contains every lung.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Vec<LungScores>>> {
    study.lungs().iter().map(|bench| study.kept(&place(bench))).collect()
}

fn place(bench: &BenchConfig) -> String {
    format!("lungs/{}", bench.name)
}

/// The folder of the first controller trained for a lung.
pub(super) fn first_folder(bench: &BenchConfig) -> String {
    folder(bench, 0)
}

fn folder(bench: &BenchConfig, repeat: u64) -> String {
    format!("{}-{repeat}", place(bench))
}

fn lung(study: &Study<'_>, bench: &BenchConfig, own: PidGains, single: PidGains) -> Result<LungScores> {
    let Reproduction { seed, budget, .. } = study.reproduction;
    let (mut learned, mut open_loop, mut ticks) = (Vec::new(), Vec::new(), Vec::new());
    for repeat in 0..budget.repeats {
        let config = PipelineConfig { gains: own, seed: seed + repeat, ..budget.lung.clone() };
        let outcome = train(study, std::slice::from_ref(bench), &config, &folder(bench, repeat))?;
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

/// Collects from benches, fits simulators to each and trains one controller on all, in a subfolder of the study.
pub(super) fn train(
    study: &Study<'_>,
    benches: &[BenchConfig],
    config: &PipelineConfig,
    folder: &str,
) -> Result<Outcome> {
    train_by(study, folder, |run, progress| pipeline::run_on_benches(config, benches, Some(run), progress))
}

/// Runs a pipeline to its end in a subfolder of the study and saves its controller there.
pub(super) fn train_by<C: Trainable>(
    study: &Study<'_>,
    folder: &str,
    run: impl FnOnce(&Workspace, &Progress<'_>) -> Result<Outcome<C>, PipelineError>,
) -> Result<Outcome<C>> {
    let outcome = run(&study.folder.folder(folder), &study.progress.of(folder))?;
    if !outcome.complete {
        return Err(StudyError::Stopped);
    }
    outcome.learned.save(&study.folder.folder(folder).path(CONTROLLER))?;
    Ok(outcome)
}
