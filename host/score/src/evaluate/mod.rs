//! Scores of any controller on any bench, by the paper's protocol (Suo et al. 2021, section 5).
//!
//! A [`Plan`] gives the waveforms, their number of breaths and the sensor noise. [`evaluate`] runs them with the same
//! ventilator core as the chip and scores the *true* airway pressure, which only a bench knows. [`trace()`] records the
//! curves of a few breaths; [`ventilator::seeds`] keeps the noise of tuning, training and evaluation apart.

mod comparison;
mod effort;
mod ground;
mod plan;
mod score;
#[cfg(test)]
mod tests;
mod trace;

pub use comparison::{CompareError, Comparison, Pair, WaveformPair, compare};
pub use effort::ValveEffort;
pub use ground::{DeviceGround, Ground, PrescribedBench, SourceGround};
pub use plan::{Plan, at_pips, waveform_name, waveform_title};
pub use score::{InspirationRecord, PLATEAU_S, Score, plateau_tolerance, score_breath, valve_effort};
pub use trace::{BreathTrace, trace, trace_after, trace_source, trace_source_after};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::Breath;
use shared::control::{ControlLaw, Controller};
use shared::settings::Settings;

use plant::bench::BenchConfig;
use progress::{Progress, Stage, Task};
use ventilator::{Reseed, SourceError, Tick};

/// Scoring controllers: waveforms.
pub const EVALUATE: Stage = Stage("score waveforms");

/// Score of one waveform: mean over seeds and breaths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WaveformScore {
    /// PIP, cmH2O.
    pub pip: f32,
    /// All settings, if the waveforms differ in more than their PIPs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub settings: Option<Settings>,
    /// Its score; the overshoot is the mean of every breath's maximum.
    #[serde(flatten)]
    pub score: Score,
}

/// Result of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Scores by waveform, in the plan's order.
    pub waveforms: Vec<WaveformScore>,
    /// Mean over the waveforms.
    pub mean: Score,
    /// Mean score under each seed, in the plan's order, cmH2O.
    pub by_seed: Vec<f64>,
}

/// Result of an evaluation, or why it could not be run.
pub type Evaluated = Result<Evaluation, SourceError>;

/// Runs a controller on a bench by a plan. The result does not depend on the number of threads.
///
/// # Errors
/// The error of the first waveform, in the plan's order, that could not be run: refused settings or a fault of the
/// ventilator.
pub fn evaluate(bench: &BenchConfig, controller: &Controller, plan: &Plan) -> Evaluated {
    evaluate_law(bench, controller, plan, &Progress::silent())
}

/// Like [`evaluate`], for any other controller; it can be stopped.
///
/// # Errors
/// See [`evaluate`]; also [`SourceError::Stopped`].
pub fn evaluate_law<C: ControlLaw + Clone + Sync>(
    bench: &BenchConfig,
    controller: &C,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Evaluated {
    let of_waveform = |settings: Settings| plan.seeds.iter().map(move |seed| (settings, *seed));
    let jobs: Vec<(Settings, u64)> = plan.waveforms.iter().copied().flat_map(of_waveform).collect();
    let task = progress.task(EVALUATE, jobs.len());
    let scores = side_by_side(&jobs, &task, |(settings, seed)| {
        let mut source = plan.source(bench, controller.clone(), settings, *seed)?;
        run(plan, &breaths(plan, settings), &mut |breath, sink| source.breathe(breath, sink))
    })?;
    Ok(summarize(plan, &scores))
}

/// Runs all jobs on all threads until the task is stopped.
///
/// # Errors
/// The first one in the order of the jobs; [`SourceError::Stopped`] if stopped.
pub fn side_by_side<T: Sync, R: Send>(
    jobs: &[T],
    task: &Task<'_>,
    work: impl Fn(&T) -> Result<R, SourceError> + Sync,
) -> Result<Vec<R>, SourceError> {
    let outcomes: Vec<Result<R, SourceError>> = jobs
        .par_iter()
        .map(|job| {
            if task.stopped() {
                return Err(SourceError::Stopped);
            }
            let result = work(job)?;
            task.advance(1);
            Ok(result)
        })
        .collect();
    outcomes.into_iter().collect()
}

/// Runs a controller on any other source by a plan, one waveform after the other. Scores the measured pressure if the
/// true pressure is unknown.
///
/// # Errors
/// The error of the first waveform that could not be run.
pub fn evaluate_source<C: Clone>(
    source: &mut dyn Reseed<C>,
    controller: &C,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Evaluated {
    let task = progress.task(EVALUATE, plan.waveforms.len() * plan.seeds.len());
    let mut scores = Vec::new();
    for settings in &plan.waveforms {
        for seed in &plan.seeds {
            if task.stopped() {
                return Err(SourceError::Stopped);
            }
            source.reseed(*seed);
            source.configure(controller.clone(), None)?;
            let breaths = breaths(plan, settings);
            source.upcoming(&breaths)?;
            scores.push(run(plan, &breaths, &mut |breath, sink| source.breath(breath, sink))?);
            task.advance(1);
        }
    }
    Ok(summarize(plan, &scores))
}

/// Combines the scores of all runs, ordered by waveform, then by seed.
fn summarize(plan: &Plan, scores: &[Score]) -> Evaluation {
    let seeds = plan.seeds.len();
    let waveforms: Vec<WaveformScore> = plan
        .waveforms
        .iter()
        .zip(scores.chunks(seeds.max(1)))
        .map(|(settings, scores)| WaveformScore {
            pip: settings.pip,
            settings: plan.beside_pip(settings),
            score: Score::mean(scores),
        })
        .collect();
    let of_seed = |index| -> Vec<Score> { scores.iter().skip(index).step_by(seeds).copied().collect() };
    Evaluation {
        mean: Score::mean(&waveforms.iter().map(|w| w.score).collect::<Vec<_>>()),
        waveforms,
        by_seed: (0..seeds).map(|index| Score::mean(&of_seed(index)).score).collect(),
    }
}

/// Settings of all breaths of one waveform.
fn breaths(plan: &Plan, settings: &Settings) -> Vec<Settings> {
    let mut breaths = vec![*settings; plan.warm_up + plan.breaths];
    // A controller that learns from breath to breath may forget when the settings change.
    if let Some(last) = breaths.last_mut().filter(|_| plan.warm_up <= 1) {
        *last = cut_short(settings);
    }
    breaths
}

/// Runs one breath with these settings and passes each tick to the sink.
type Breathe<'a> = dyn FnMut(&Settings, &mut dyn FnMut(&Tick)) -> Result<(), SourceError> + 'a;

/// Runs and scores all breaths of one waveform.
fn run(plan: &Plan, breaths: &[Settings], breathe: &mut Breathe<'_>) -> Result<Score, SourceError> {
    let mut scores = Vec::with_capacity(plan.breaths);
    for (number, breath) in breaths.iter().enumerate() {
        let mut record = InspirationRecord::default();
        let planned = Breath::new(breath, plan.period_us)?;
        breathe(breath, &mut |tick| record.add_planned(tick, &planned))?;
        if number >= plan.warm_up {
            scores.push(record.score(breath, plan.period_us));
        }
    }
    Ok(Score::mean(&scores))
}

/// The same inspiration with the shortest expiration that the schema's bounds allow: nothing after the last inspiration
/// is scored.
fn cut_short(settings: &Settings) -> Settings {
    let short = Settings {
        fall_time: 0.0,
        // Slightly below the fastest rate, because rounding could exceed it.
        rate: (59.99 / settings.inspiratory_time).max(settings.rate),
        ..*settings
    };
    if short.validate().is_ok() { short } else { *settings }
}
