//! The main job from end to end on one lung: search the best PID, learn a controller, compare both on the true
//! bench, write everything down.

mod report;
mod summary;
#[cfg(test)]
mod tests;
mod venue;

use std::path::Path;
use std::time::Instant;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use crate::error::{Result, StudyError};
use data::files::{read_json, write_atomically, write_json, write_json_indented};
use judge::baselines::{Best, Search, tune_pid};
use judge::evaluate::{BreathTrace, Evaluation, Plan};
use learn::pipeline::{self, Folder, Outcome, PipelineConfig};
use plant::bench::BenchConfig;
use progress::{Progress, Stage};

pub use summary::{Compared, ContestantMeans, DemoSummary};
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
    pub traces: Vec<BreathTrace>,
}

/// PIPs of the waveforms shown in the report, cmH2O.
pub const TRACED_PIPS: [f32; 3] = [10.0, 20.0, 35.0];
/// Breaths shown of each.
const TRACED_BREATHS: usize = 3;

/// The finished job.
#[derive(Clone, Debug)]
pub struct Demo {
    /// Figures.
    pub summary: DemoSummary,
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
pub fn run(config: &DemoConfig, out: &Path, progress: &Progress<'_>) -> Result<Demo> {
    let started = Instant::now();
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

/// The best PID, searched or as an earlier run in this folder found it.
fn tuned(config: &DemoConfig, out: &Path, progress: &Progress<'_>) -> Result<Best> {
    let plan = Plan { period_us: config.pipeline.period_us, ..Plan::tuning(config.pipeline.seed) };
    let file = out.join("tuning.json");
    // A file that cannot be read is as good as none: the search is done again.
    let earlier = read_json::<Tuned>(&file).ok().flatten();
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
    write_json(&file, &tuned).map_err(StudyError::file(&file))?;
    Ok(tuned.best)
}

fn learn(config: &DemoConfig, gains: PidGains, out: &Path, progress: &Progress<'_>) -> Result<Outcome> {
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
) -> Result<Vec<Contestant>> {
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
    fn save(&self, out: &Path) -> Result<()> {
        self.outcome.plants[0].recording.save(out.join("recording.parquet"))?;
        if let Some(simulator) = self.outcome.plants[0].simulators.first() {
            simulator.save(&out.join("simulator.safetensors"))?;
        }
        self.outcome.learned.save(&out.join("controller.safetensors"))?;
        let (image, summary) = (out.join("weights.bin"), out.join("summary.json"));
        write_atomically(&image, &self.outcome.learned.image()?).map_err(StudyError::file(&image))?;
        write_json_indented(&summary, &self.summary).map_err(StudyError::file(&summary))?;
        Ok(self.report().save(out.join("report.html"))?)
    }
}
