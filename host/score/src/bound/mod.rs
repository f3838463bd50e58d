//! Reference bound: the best command sequence found for a bench that is known in every detail.
//!
//! A controller sees a noisy, delayed pressure; [`bounds`] sees the bench itself and may repeat a breath as often as it
//! needs. It searches the commands of the inspiration tick by tick, from the periodic state that these commands lead
//! to, and scores the true airway pressure as an evaluation does. The search descends from several starts by
//! Gauss-Newton steps on responses measured on the bench, adds nodes where the command bends, then perturbs the best
//! sequence and descends again. It is a search, not a proof: [`WaveformBound::spread`] is the difference between the
//! starts' results, and a larger [`BoundConfig::effort`] shows what a longer search would gain.
//!
//! A patient who breathes regularly at the set rate triggers each breath, [`BoundConfig::trigger_delay_ms`] after the
//! beginning of an effort. The search knows this effort in advance, as no controller can.

mod bench_breath;
mod descent;
mod search;
mod shape;
mod start;
#[cfg(test)]
mod tests;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::Breath;
use shared::settings::{Settings, SettingsError};
use thiserror::Error;

use crate::breathing::RHYTHMS;
use crate::evaluate::{Plan, Score, valve_effort};
use bench_breath::BenchBreath;
use plant::bench::{BenchConfig, PatientConfig};
use progress::{Progress, Stage};
use search::Found;
use ventilator::SourceError;

/// Searching the reference bound: stages of the search.
pub const BOUND: Stage = Stage("search reference bound");

/// Configuration of the search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoundConfig {
    /// Seed of the perturbations.
    pub seed: u64,
    /// Factor on steps and perturbations; doubling it from 1 improves scores by less than 1 %.
    pub effort: u32,
    /// Time from the beginning of an effort to the breath that it triggers, ms.
    pub trigger_delay_ms: u32,
    /// Keep pressure, target and command of every waveform.
    pub trace: bool,
    /// Number of the breath from rest, from 1, that is searched, after breaths that follow the target; without it, a breath after
    /// infinitely many with the same commands. A lung that keeps most of its gas would amplify each change of those many times over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub breath: Option<u32>,
}

impl Default for BoundConfig {
    fn default() -> Self {
        Self { seed: 1, effort: 1, trigger_delay_ms: 30, trace: false, breath: None }
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

/// Reference bound of one waveform.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WaveformBound {
    /// PIP, cmH2O.
    pub pip: f32,
    /// All settings, if the waveforms differ in more than their PIPs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub settings: Option<Settings>,
    /// Score of the best sequence found.
    #[serde(flatten)]
    pub score: Score,
    /// Score of the second-best start minus that of the best, cmH2O.
    pub spread: f64,
    /// The inspiration, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trace: Option<BoundTrace>,
}

/// Reference bounds of all waveforms on one bench.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bound {
    /// Name of the bench.
    pub lung: String,
    /// Bounds by waveform, in the plan's order. Waveforms that were not finished when the search was stopped are
    /// omitted.
    pub waveforms: Vec<WaveformBound>,
    /// Mean over the waveforms.
    pub mean: Score,
    /// False if waveforms are missing.
    pub complete: bool,
}

/// Why a bound cannot be computed.
#[derive(Debug, Error)]
pub enum BoundError {
    /// Breaths differ, so no single inspiration represents them.
    #[error(
        "the patient of bench {0} breathes irregularly, coughs or changes, or its leak does, so a bound for one breath does not apply to the next: set effort_variability_percent, double_efforts_percent, effort_wanes_percent, cough_cmh2o, change_at_breath and resistance_growth_percent_per_hour to 0, and remove leak_changes"
    )]
    Patient(String),
    /// Efforts drift against the breaths.
    #[error(
        "the patient of bench {name} must make one effort per breath, so that each triggers one: set effort_rate_per_min to {rate}, or set another rate with --settings"
    )]
    OtherRate {
        /// Name of the bench.
        name: String,
        /// Breaths per minute.
        rate: f64,
    },
    /// The bench, settings or period cannot be run.
    #[error(transparent)]
    Source(#[from] SourceError),
}

/// The bench with a patient who makes regular efforts of this strength, cmH2O, one for each breath of these settings: as a
/// bound for triggered breaths needs it.
///
/// # Errors
/// Settings that are refused.
pub fn triggering(
    bench: &BenchConfig,
    strength: f64,
    settings: &Settings,
    period_us: u32,
) -> Result<BenchConfig, SettingsError> {
    let breath = Breath::new(settings, period_us)?;
    let patient = PatientConfig {
        effort_cmh2o: strength,
        effort_rate_per_min: 60.0 / bench_breath::length_s(&breath),
        effort_duration_s: RHYTHMS[1].1,
        ..PatientConfig::default()
    };
    Ok(BenchConfig { name: format!("{}, effort {strength}", bench.name), patient, ..bench.clone() })
}

/// The best score found on each bench for each waveform of the plan. Only the plan's period and waveforms are
/// used: the search has no noise and repeats one breath. Runs in parallel over benches and waveforms; the result does
/// not depend on the number of threads.
///
/// # Errors
/// Before any search: a patient whose breaths differ, a leak that changes, a bench or settings that are refused, or a period that the bench
/// cannot run.
pub fn bounds(
    benches: &[BenchConfig],
    plan: &Plan,
    search: &BoundConfig,
    progress: &Progress<'_>,
) -> Result<Vec<Bound>, BoundError> {
    let mut jobs = Vec::with_capacity(benches.len() * plan.waveforms.len());
    for bench in benches {
        if !repeats(bench) {
            return Err(BoundError::Patient(bench.name.clone()));
        }
        for (number, settings) in plan.waveforms.iter().enumerate() {
            let breath = BenchBreath::new(bench, settings, plan.period_us, search.trigger_delay_ms)?;
            jobs.push((bench, number, breath));
        }
    }
    let task = progress.task(BOUND, jobs.len() * search::stages(search));
    let found: Vec<Option<WaveformBound>> = jobs
        .par_iter()
        .map(|(bench, number, breath)| {
            let begun = search.breath.map(|number| search::at_breath(breath, &bench.valve, number));
            let breath = begun.as_ref().unwrap_or(breath);
            let found = search::search(breath, &bench.valve, search, *number as u64, &task)?;
            Some(waveform(plan, breath, found, search.trace))
        })
        .collect();
    let per_bench = plan.waveforms.len().max(1);
    Ok(benches.iter().zip(found.chunks(per_bench)).map(|(bench, found)| summarize(bench, found)).collect())
}

/// Whether every breath with the same commands is the same, if it follows the efforts.
fn repeats(bench: &BenchConfig) -> bool {
    let patient = &bench.patient;
    let differs =
        [patient.effort_variability_percent, patient.double_efforts_percent, patient.effort_wanes_percent];
    let regular = differs.iter().all(|percent| *percent <= 0.0);
    let quiet = (regular || patient.effort_cmh2o <= 0.0) && patient.cough_cmh2o <= 0.0;
    let steady = patient.change_at_breath == 0 && patient.resistance_growth_percent_per_hour <= 0.0;
    quiet && steady && bench.circuit.leak_changes.is_empty()
}

fn waveform(plan: &Plan, breath: &BenchBreath, found: Found, trace: bool) -> WaveformBound {
    let pressure = breath.inspire(&breath.periodic(&found.commands), &found.commands);
    let period = f64::from(breath.breath.period_s());
    let commands: Vec<f64> = found.commands.iter().copied().map(f64::from).collect();
    let score = Score {
        effort: valve_effort(breath.breath.settings(), &commands, period),
        ..breath.score(&pressure)
    };
    let trace = trace.then(|| BoundTrace {
        time_s: (0..pressure.len()).map(|tick| tick as f64 * period).collect(),
        target: breath.target.clone(),
        pressure,
        u_in: found.commands,
    });
    let waveform = breath.breath.settings();
    let settings = plan.beside_pip(waveform);
    WaveformBound { pip: waveform.pip, settings, score, spread: found.spread, trace }
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
