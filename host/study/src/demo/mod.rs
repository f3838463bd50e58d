//! The main job from end to end on one lung: search the best PID, learn a controller, compare both on the true
//! bench, write everything down.

mod report;
mod summary;
#[cfg(test)]
mod tests;
mod venue;

use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::{GainError, Pid, PidGains};
use thiserror::Error;

use data::files::write_atomically;
use data::json::{self, JsonError};
use data::recording::DatasetError;
use data::tensors::TensorError;
use judge::baselines::{Best, Search, TuneError, tune_pid};
use judge::evaluate::{Evaluation, Plan, Trace};
use learn::controller::learned::LearnedError;
use learn::pipeline::{self, Folder, Outcome, PipelineConfig, PipelineError};
use plant::bench::BenchConfig;
use progress::{Progress, Stage};
use show::report::ReportError;
use ventilator::SourceError;

pub use summary::{Compared, Means, Summary};
pub use venue::Venue;

/// What to run.
#[derive(Clone, Debug)]
pub struct DemoConfig {
    /// The bench.
    pub bench: BenchConfig,
    /// Search of the rival.
    pub search: Search,
    /// Rounds of collect, fit and train; seed and period hold for everything else too. Its gains are replaced
    /// by those of the best PID found.
    pub pipeline: PipelineConfig,
    /// Where breaths are recorded and compared; the search is always in this process.
    pub venue: Venue,
}

/// Why the job cannot be finished.
#[derive(Debug, Error)]
pub enum DemoError {
    /// Search.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// Learning.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// Evaluation.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// Gains.
    #[error(transparent)]
    Gain(#[from] GainError),
    /// Recording.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Simulator's file.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// Controller's file or image.
    #[error(transparent)]
    Learned(#[from] LearnedError),
    /// Report.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// Settings or figures.
    #[error(transparent)]
    Json(#[from] JsonError),
    /// Another file.
    #[error("cannot write {path}: {reason}")]
    File {
        /// File.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// Stopped before the search was done.
    #[error("stopped during the search of the best PID; nothing was learned yet, start again")]
    Stopped,
}

/// One controller's part of the comparison.
#[derive(Clone, Debug)]
pub struct Contestant {
    /// Name in tables and legends.
    pub name: &'static str,
    /// The controller.
    pub controller: Controller,
    /// How it did on the true bench.
    pub evaluation: Evaluation,
    /// Two breaths at each PIP of [`TRACED_PIPS`].
    pub traces: Vec<Trace>,
}

/// PIPs of the waveforms shown in the report, cmH2O.
pub const TRACED_PIPS: [f32; 3] = [10.0, 20.0, 35.0];
/// Breaths shown of each.
const TRACED_BREATHS: usize = 3;

/// The finished job.
#[derive(Clone, Debug)]
pub struct Demo {
    /// Figures.
    pub summary: Summary,
    /// Best of each kind of PID.
    pub best: Best,
    /// What was learned.
    pub outcome: Outcome,
    /// P, I, PID, learned.
    pub contestants: Vec<Contestant>,
    /// Plan of the comparison.
    pub plan: Plan,
}

/// Best gains with what they belong to, kept in the folder.
#[derive(Serialize, Deserialize)]
struct Tuned {
    bench: BenchConfig,
    search: Search,
    plan: Plan,
    best: Best,
}

/// Runs the whole job and writes its files to `out`; a stopped job goes on there.
///
/// # Errors
/// The first step that fails; what earlier steps wrote stays.
pub fn run(config: &DemoConfig, out: &Path, progress: &Progress<'_>) -> Result<Demo, DemoError> {
    let started = Instant::now();
    let best = tuned(config, out, progress)?;
    let outcome = learn(config, best.pid.gains, out, progress)?;
    let plan = Plan { period_us: config.pipeline.period_us, ..Plan::evaluation(config.pipeline.seed) };
    let contestants = compare(config, &best, &outcome, &plan, progress)?;
    let mut summary = Summary::new(config, &best, &outcome, &contestants);
    summary.wall_s = started.elapsed().as_secs_f64();
    let demo = Demo { summary, best, outcome, contestants, plan };
    demo.save(out)?;
    Ok(demo)
}

/// The best PID, searched or as an earlier run in this folder found it.
fn tuned(config: &DemoConfig, out: &Path, progress: &Progress<'_>) -> Result<Best, DemoError> {
    let plan = Plan { period_us: config.pipeline.period_us, ..Plan::tuning(config.pipeline.seed) };
    let file = out.join("tuning.json");
    // A file of another version is searched again, as one of another bench is.
    if let Ok(Some(tuned)) = json::read::<Tuned>(&file)
        && (&tuned.bench, &tuned.search, &tuned.plan) == (&config.bench, &config.search, &plan)
    {
        return Ok(tuned.best);
    }
    let result = tune_pid(std::slice::from_ref(&config.bench), &config.search, &plan, progress)?;
    if !result.complete {
        return Err(DemoError::Stopped);
    }
    let (bench, search) = (config.bench.clone(), config.search.clone());
    let tuned = Tuned { bench, search, plan, best: result.over_all };
    json::write(&file, &tuned)?;
    Ok(tuned.best)
}

fn learn(
    config: &DemoConfig,
    gains: PidGains,
    out: &Path,
    progress: &Progress<'_>,
) -> Result<Outcome, DemoError> {
    let pipeline = PipelineConfig { gains, ..config.pipeline.clone() };
    let base = Controller::Pid(Pid::new(gains, pipeline.period_us)?);
    let (settings, period_us) = (pipeline.collect.settings, pipeline.period_us);
    let source = |seed| config.venue.source(&config.bench, base.clone(), &settings, period_us, seed);
    let folder = Folder::new(out.join("run"));
    Ok(pipeline::run(&pipeline, &[&source], Some(&folder), progress)?)
}

fn compare(
    config: &DemoConfig,
    best: &Best,
    outcome: &Outcome,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<Vec<Contestant>, DemoError> {
    let pid = |gains| Pid::new(gains, plan.period_us).map(Controller::Pid);
    // A vector: on the stack, controllers with their weights would be large.
    let controllers = vec![
        ("P only", pid(best.p_only.gains)?),
        ("I only", pid(best.i_only.gains)?),
        ("PID", pid(best.pid.gains)?),
        ("learned", Controller::Residual(outcome.learned.controller.clone())),
    ];
    let task = progress.task(Stage::Evaluate, controllers.len() * plan.pips.len() * plan.seeds.len());
    // Side by side: a board keeps one core busy.
    let contestant = |(name, controller): (&'static str, Controller)| {
        let evaluation = config.venue.evaluate(&config.bench, &controller, plan, &task.part())?;
        let traces = config.venue.traces(&config.bench, &controller, plan)?;
        Ok(Contestant { name, controller, evaluation, traces })
    };
    controllers.into_par_iter().map(contestant).collect()
}

impl Demo {
    fn save(&self, out: &Path) -> Result<(), DemoError> {
        self.outcome.plants[0].recording.save(out.join("recording.parquet"))?;
        if let Some(simulator) = self.outcome.plants[0].simulators.first() {
            simulator.save(&out.join("simulator.safetensors"))?;
        }
        self.outcome.learned.save(&out.join("controller.safetensors"))?;
        write(&out.join("weights.bin"), &self.outcome.learned.image()?)?;
        json::write(&out.join("summary.json"), &self.summary)?;
        Ok(self.report().save(out.join("report.html"))?)
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), DemoError> {
    write_atomically(path, bytes)
        .map_err(|e| DemoError::File { path: path.to_owned(), reason: e.to_string() })
}
