//! The whole pipeline on one lung: search the best PID, learn a controller, compare both on the true bench, and write
//! the files; the report of it all.

mod report;
mod summary;
#[cfg(test)]
mod tests;
mod venue;

use std::path::Path;
use std::time::Instant;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use crate::error::{Result, StudyError};
use data::files::write_atomically;
use data::workspace::{Workspace, WorkspaceError};
use learn::pipeline::{self, Outcome, PipelineConfig, RunFolder};
use plant::bench::BenchConfig;
use progress::Progress;
use score::baselines::{Best, Search, tune_pid};
use score::evaluate::{BreathTrace, EVALUATE, Evaluation, Plan};

pub use summary::{Compared, ContestantMeans, DemoSummary};
pub use venue::Venue;

/// Configuration of the demo.
#[derive(Clone, Debug)]
pub struct DemoConfig {
    /// The bench.
    pub bench: BenchConfig,
    /// Search for the best PID.
    pub search: Search,
    /// Rounds of collect, fit and train. Its seed and period also apply to everything else; its gains are replaced by
    /// those of the best PID found.
    pub pipeline: PipelineConfig,
    /// Where breaths are recorded and compared; the PID search always runs in this process.
    pub venue: Venue,
}

/// One controller's part of the comparison.
#[derive(Clone, Debug)]
pub struct Contestant {
    /// Name in tables and legends.
    pub name: &'static str,
    /// The controller.
    pub controller: Controller,
    /// Its scores on the true bench.
    pub evaluation: Evaluation,
    /// Two breaths at each PIP of [`TRACED_PIPS`].
    pub traces: Vec<BreathTrace>,
}

/// PIPs of the waveforms shown in the report, cmH2O.
pub const TRACED_PIPS: [f32; 3] = [10.0, 20.0, 35.0];
/// Number of breaths shown at each PIP.
const TRACED_BREATHS: usize = 3;

/// The results of a demo.
#[derive(Clone, Debug)]
pub struct Demo {
    /// Scores and settings, as in `summary.json`.
    pub summary: DemoSummary,
    /// The best PID of each kind.
    pub best: Best,
    /// The learned controller and its training history.
    pub outcome: Outcome,
    /// P, I, PID and learned controller, in this order.
    pub contestants: Vec<Contestant>,
    /// Plan of the comparison.
    pub plan: Plan,
}

/// The best gains with the settings they belong to, kept in the folder.
#[derive(Serialize, Deserialize)]
struct Tuned {
    bench: BenchConfig,
    search: Search,
    plan: Plan,
    best: Best,
}

/// What must match to continue a stopped demo.
#[derive(Serialize, Deserialize)]
struct Claim {
    bench: BenchConfig,
    search: Search,
    pipeline: PipelineConfig,
}

/// Runs the demo and writes its files to `out`, without the report; a stopped demo continues there.
///
/// # Errors
/// The error of the first step that fails; files of earlier steps stay.
pub fn run(config: &DemoConfig, out: &Path, progress: &Progress<'_>) -> Result<Demo> {
    let started = Instant::now();
    Workspace::new(out).claim(&Claim {
        bench: config.bench.clone(),
        search: config.search.clone(),
        pipeline: config.pipeline.clone(),
    })?;
    let best = tuned(config, out, progress)?;
    let outcome = learn(config, best.pid.gains, out, progress)?;
    let plan = Plan { period_us: config.pipeline.period_us, ..Plan::evaluation(config.pipeline.seed) };
    let contestants = compare(config, &best, &outcome, &plan, progress)?;
    let mut summary = DemoSummary::new(config, &best, &outcome, &contestants);
    summary.wall_s = started.elapsed().as_secs_f64();
    let demo = Demo { summary, best, outcome, contestants, plan };
    demo.save(out)?;
    Ok(demo)
}

/// The best PID, from a new search or from an earlier run in this folder.
fn tuned(config: &DemoConfig, out: &Path, progress: &Progress<'_>) -> Result<Best> {
    let plan = Plan { period_us: config.pipeline.period_us, ..Plan::tuning(config.pipeline.seed) };
    let (folder, file) = (Workspace::new(out), "tuning.json");
    // An unreadable file counts as none: the search runs again.
    let earlier = folder.load::<Tuned>(file).ok().flatten();
    if let Some(tuned) = earlier
        && (&tuned.bench, &tuned.search, &tuned.plan) == (&config.bench, &config.search, &plan)
    {
        return Ok(tuned.best);
    }
    let result = tune_pid(std::slice::from_ref(&config.bench), &config.search, &plan, progress)?;
    if !result.complete {
        return Err(StudyError::SearchStopped);
    }
    let (bench, search) = (config.bench.clone(), config.search.clone());
    let tuned = Tuned { bench, search, plan, best: result.over_all };
    folder.save(file, &tuned)?;
    Ok(tuned.best)
}

fn learn(config: &DemoConfig, gains: PidGains, out: &Path, progress: &Progress<'_>) -> Result<Outcome> {
    let pipeline = PipelineConfig { gains, ..config.pipeline.clone() };
    let base = Controller::Pid(Pid::new(gains, pipeline.period_us)?);
    let (settings, period_us) = (pipeline.collect.settings, pipeline.period_us);
    let source = |seed| config.venue.source(&config.bench, base.clone(), &settings, period_us, seed);
    let folder = Workspace::new(out.join("run"));
    let folder = RunFolder { workspace: &folder, plants: vec![json!(config.bench)] };
    Ok(pipeline::run(&pipeline, &[&source], Some(folder), progress)?)
}

fn compare(
    config: &DemoConfig,
    best: &Best,
    outcome: &Outcome,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<Vec<Contestant>> {
    let pid = |gains| Pid::new(gains, plan.period_us).map(Controller::Pid);
    // A vector, because controllers with their weights would need much stack.
    let controllers = vec![
        ("P only", pid(best.p_only.gains)?),
        ("I only", pid(best.i_only.gains)?),
        ("PID", pid(best.pid.gains)?),
        ("learned", Controller::Residual(outcome.learned.controller.clone())),
    ];
    let task = progress.task(EVALUATE, controllers.len() * plan.waveforms.len() * plan.seeds.len());
    // In parallel: a board keeps one core busy.
    let contestant = |(name, controller): (&'static str, Controller)| {
        let evaluation = config.venue.evaluate(&config.bench, &controller, plan, &task.part())?;
        let traces = config.venue.traces(&config.bench, &controller, plan)?;
        Ok(Contestant { name, controller, evaluation, traces })
    };
    controllers.into_par_iter().map(contestant).collect()
}

impl Demo {
    fn save(&self, out: &Path) -> Result<()> {
        self.outcome.plants[0].recording.save(out.join("recording.parquet"))?;
        if let Some(simulator) = self.outcome.plants[0].simulators.first() {
            simulator.save(&out.join("simulator.safetensors"))?;
        }
        self.outcome.learned.save(&out.join("controller.safetensors"))?;
        let image = out.join("weights.bin");
        write_atomically(&image, &self.outcome.learned.image()?).map_err(WorkspaceError::file(&image))?;
        Ok(Workspace::new(out).save_indented("summary.json", &self.summary)?)
    }
}
