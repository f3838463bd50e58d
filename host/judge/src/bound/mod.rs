//! What no controller can beat: the best command sequence for a bench that is known in every detail.
//!
//! A controller sees a noisy, late pressure; [`bounds`] sees the bench itself and may try a breath as often as it
//! likes. It searches the commands of the inspiration freely, tick by tick, from the state that breathing with just
//! these commands leads to, and scores the true airway pressure as an evaluation does. The search goes down from
//! several starts by Gauss-Newton steps on responses measured on the bench, adds nodes where the command bends, then
//! shakes the best and goes down again. It finds no proof: [`WaveformBound::spread`] tells how far apart the starts
//! ended, and a greater [`BoundConfig::effort`] shows what more searching would gain.

mod bench_breath;
mod descent;
mod search;
mod shape;
mod start;
#[cfg(test)]
mod tests;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::evaluate::{Plan, Score};
use bench_breath::BenchBreath;
use plant::bench::{BenchConfig, PatientConfig};
use progress::{Progress, Stage};
use search::Found;
use ventilator::SourceError;

/// How to search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoundConfig {
    /// Seed of the shakes.
    pub seed: u64,
    /// Factor on steps and shakes; 1 is enough for the figures to stand within 1 %.
    pub effort: u32,
    /// Keep pressure, target and command of every waveform.
    pub trace: bool,
}

impl Default for BoundConfig {
    fn default() -> Self {
        Self { seed: 1, effort: 1, trace: false }
    }
}

/// One inspiration under the best sequence found; columns of equal length, a row for every control tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BoundTrace {
    /// Time since the start of the inspiration, s.
    pub time_s: Vec<f64>,
    /// Target, cmH2O.
    pub target: Vec<f64>,
    /// True airway pressure, cmH2O.
    pub pressure: Vec<f64>,
    /// Command of the inspiratory valve, percent.
    pub u_in: Vec<f32>,
}

/// Bound of one waveform.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WaveformBound {
    /// PIP, cmH2O.
    pub pip: f32,
    /// Figures of the best sequence found.
    #[serde(flatten)]
    pub score: Score,
    /// How much higher than the best start the next best one ended, cmH2O.
    pub spread: f64,
    /// The inspiration, if it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trace: Option<BoundTrace>,
}

/// Bounds of all waveforms on one bench.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bound {
    /// Name of the bench.
    pub lung: String,
    /// By waveform, as in the plan; without those that were not finished when the search was stopped, as half a
    /// search bounds nothing.
    pub waveforms: Vec<WaveformBound>,
    /// Mean over the waveforms.
    pub mean: Score,
    /// False if waveforms are missing.
    pub complete: bool,
}

/// Why there is no bound.
#[derive(Debug, Error)]
pub enum BoundError {
    /// Breaths differ, so there is no inspiration that stands for all.
    #[error(
        "the patient of bench {0} breathes, coughs or changes: no two breaths are alike, and a bound for one says nothing of the next; set effort_cmh2o, cough_cmh2o and change_at_breath to 0"
    )]
    Patient(String),
    /// A bench, settings or a period that cannot be run.
    #[error(transparent)]
    Source(#[from] SourceError),
}

/// The best score that any commands reach on each bench, for each waveform of the plan. Of the plan only period,
/// settings and PIPs count: what is searched has no noise, and is the breath that all later ones repeat. Runs in
/// parallel over benches and waveforms; the result does not depend on the number of threads.
///
/// # Errors
/// Before any search: a patient who is not passive, a bench or settings that are refused, or a period that the bench
/// cannot run.
pub fn bounds(
    benches: &[BenchConfig],
    plan: &Plan,
    search: &BoundConfig,
    progress: &Progress<'_>,
) -> Result<Vec<Bound>, BoundError> {
    let mut jobs = Vec::with_capacity(benches.len() * plan.pips.len());
    for bench in benches {
        if !passive(&bench.patient) {
            return Err(BoundError::Patient(bench.name.clone()));
        }
        for (number, pip) in plan.pips.iter().enumerate() {
            jobs.push((bench, number, BenchBreath::new(bench, &plan.waveform(*pip), plan.period_us)?));
        }
    }
    let task = progress.task(Stage::Bound, jobs.len() * search::stages(search));
    let found: Vec<Option<WaveformBound>> = jobs
        .par_iter()
        .map(|(bench, number, breath)| {
            let found = search::search(breath, &bench.valve, search, *number as u64, &task)?;
            Some(waveform(breath, found, search.trace))
        })
        .collect();
    let per_bench = plan.pips.len().max(1);
    Ok(benches.iter().zip(found.chunks(per_bench)).map(|(bench, found)| summarize(bench, found)).collect())
}

fn passive(patient: &PatientConfig) -> bool {
    patient.effort_cmh2o <= 0.0 && patient.cough_cmh2o <= 0.0 && patient.change_at_breath == 0
}

fn waveform(breath: &BenchBreath, found: Found, trace: bool) -> WaveformBound {
    let pressure = breath.inspire(&breath.periodic(&found.commands), &found.commands);
    let score = breath.score(&pressure);
    let period = f64::from(breath.breath.period_s());
    let trace = trace.then(|| BoundTrace {
        time_s: (0..pressure.len()).map(|tick| tick as f64 * period).collect(),
        target: breath.target.clone(),
        pressure,
        u_in: found.commands,
    });
    WaveformBound { pip: breath.breath.settings().pip, score, spread: found.spread, trace }
}

fn summarize(bench: &BenchConfig, found: &[Option<WaveformBound>]) -> Bound {
    let waveforms: Vec<WaveformBound> = found.iter().flatten().cloned().collect();
    Bound {
        lung: bench.name.clone(),
        mean: Score::mean(&waveforms.iter().map(|w| w.score).collect::<Vec<_>>()),
        complete: waveforms.len() == found.len(),
        waveforms,
    }
}
