//! Breathing patients: scores of the breaths that their efforts trigger, beside those that the clock starts.
//!
//! Efforts of several strengths and rhythms meet each lung. A breath is scored like any other: over its inspiration,
//! against the target from its first tick on. What an effort adds is a pull on the pressure during the inspiration, a
//! start slightly below PEEP, and a lung that has not yet emptied. Every mean is taken waveform by waveform, so that the
//! kinds of breaths can be compared although a controller meets them in different numbers.

#[cfg(test)]
mod tests;

use rayon::prelude::*;
use serde::Serialize;
use shared::breath::Breath;
use shared::control::ControlLaw;
use shared::settings::Settings;

use crate::evaluate::{EVALUATE, InspirationRecord, Plan};
use plant::bench::{BenchConfig, PatientConfig};
use plant::prescriptions::field;
use progress::{Progress, Task};
use ventilator::SourceError;

/// Mean peak of the efforts, cmH2O.
pub const STRENGTHS: [f64; 3] = [3.0, 6.0, 10.0];
/// Rate of the efforts as a share of the set rate, and their duration, s. Slower patients leave breaths to the clock.
pub const RHYTHMS: [(f64, f64); 3] = [(0.7, 1.0), (0.9, 0.8), (1.2, 0.6)];
/// Spread of peaks and intervals, percent of their means (sd).
pub const VARIABILITY_PERCENT: f64 = 15.0;

/// Scores of a controller by kind of breath: mean absolute errors of the true airway pressure over the inspiration,
/// cmH2O. `None` where a waveform had no such breath.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Kinds {
    /// Breaths of the same lung without efforts.
    pub passive: Option<f64>,
    /// Breaths of the breathing patients that the clock started.
    pub timed: Option<f64>,
    /// Breaths that an effort started.
    pub triggered: Option<f64>,
}

impl Kinds {
    /// Mean of each kind; `None` where one has no value.
    fn mean(all: &[Self]) -> Self {
        let mean = |kind: fn(&Self) -> Option<f64>| mean(all.iter().map(kind));
        Self { passive: mean(|k| k.passive), timed: mean(|k| k.timed), triggered: mean(|k| k.triggered) }
    }

    /// Score in triggered breaths relative to that in timed ones.
    pub fn triggered_to_timed(&self) -> Option<f64> {
        Some(self.triggered? / self.timed?)
    }

    /// Score in triggered breaths relative to that without efforts.
    pub fn triggered_to_passive(&self) -> Option<f64> {
        Some(self.triggered? / self.passive?)
    }
}

/// The patients of one lung with efforts of one strength.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Patients {
    /// Name of the bench.
    pub lung: String,
    /// Mean peak of the efforts, cmH2O.
    pub effort_cmh2o: f64,
    /// Number of scored breaths that the clock started, and that an effort started, with the first controller.
    pub timed_breaths: usize,
    /// See `timed_breaths`.
    pub triggered_breaths: usize,
    /// Scores by controller, in the order given.
    pub controllers: Vec<Kinds>,
}

/// Result of an evaluation on breathing patients.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BreathingScores {
    /// Patients by lung, then by strength; only the complete ones if the evaluation was stopped.
    pub patients: Vec<Patients>,
    /// Mean over the patients, by controller.
    pub mean: Vec<Kinds>,
}

/// Breaths of one kind and waveform.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    breaths: usize,
    score: f64,
}

/// Timed, then triggered breaths of one waveform.
type Sums = [Sum; 2];

/// One controller on one lung: without efforts, or with efforts of one strength.
struct Job<'a, C> {
    bench: &'a BenchConfig,
    controller: &'a C,
    strength: f64,
}

/// Scores controllers on the patients of each bench, whose own patient they replace. The result does not depend on the
/// number of threads. Stopped, it keeps the complete patients.
///
/// # Errors
/// The error of the first breath that could not be run.
pub fn breathing<C: ControlLaw + Clone + Sync>(
    benches: &[BenchConfig],
    controllers: &[&C],
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<BreathingScores, SourceError> {
    let runs = plan.waveforms.len() * plan.seeds.len() * (1 + STRENGTHS.len() * RHYTHMS.len());
    let task = progress.task(EVALUATE, benches.len() * controllers.len() * runs);
    let mut patients = Vec::new();
    for bench in benches {
        match on_bench(bench, controllers, plan, &task) {
            Ok(of_bench) => patients.extend(of_bench),
            Err(SourceError::Stopped) => break,
            Err(error) => return Err(error),
        }
    }
    let of_controller = |n: usize| patients.iter().map(|p| p.controllers[n]).collect::<Vec<_>>();
    let mean = (0..controllers.len()).map(|n| Kinds::mean(&of_controller(n))).collect();
    Ok(BreathingScores { patients, mean })
}

/// All patients of one bench.
fn on_bench<C: ControlLaw + Clone + Sync>(
    bench: &BenchConfig,
    controllers: &[&C],
    plan: &Plan,
    task: &Task<'_>,
) -> Result<Vec<Patients>, SourceError> {
    let strengths = [&[0.0], STRENGTHS.as_slice()].concat();
    let mut scores = Vec::with_capacity(strengths.len());
    for strength in strengths {
        let of = |controller: &&C| {
            let controller: &C = controller;
            waveforms(&Job { bench, controller, strength }, plan, task)
        };
        scores.push(controllers.iter().map(of).collect::<Result<Vec<_>, _>>()?);
    }
    let passive: Vec<Option<f64>> = scores[0].iter().map(|waveforms| score(waveforms, 0)).collect();
    let patients = STRENGTHS.iter().zip(&scores[1..]).map(|(strength, scores)| {
        let breaths =
            |kind: usize| scores.first().map_or(0, |s| s.iter().map(|sums| sums[kind].breaths).sum());
        let kinds = scores.iter().zip(&passive).map(|(waveforms, passive)| Kinds {
            passive: *passive,
            timed: score(waveforms, 0),
            triggered: score(waveforms, 1),
        });
        Patients {
            lung: bench.name.clone(),
            effort_cmh2o: *strength,
            timed_breaths: breaths(0),
            triggered_breaths: breaths(1),
            controllers: kinds.collect(),
        }
    });
    Ok(patients.collect())
}

/// The sums of every waveform, over all seeds and rhythms.
fn waveforms<C: ControlLaw + Clone + Sync>(
    job: &Job<'_, C>,
    plan: &Plan,
    task: &Task<'_>,
) -> Result<Vec<Sums>, SourceError> {
    let rhythms = if job.strength > 0.0 { RHYTHMS.as_slice() } else { &RHYTHMS[..1] };
    let of_waveform = |settings: &Settings| -> Result<Sums, SourceError> {
        let mut sums = Sums::default();
        for rhythm in rhythms {
            for seed in &plan.seeds {
                if task.stopped() {
                    return Err(SourceError::Stopped);
                }
                run(job, *rhythm, plan, settings, *seed, &mut sums)?;
                task.advance(1);
            }
        }
        Ok(sums)
    };
    let outcomes: Vec<_> = plan.waveforms.par_iter().map(of_waveform).collect();
    outcomes.into_iter().collect()
}

/// A patient with efforts of this mean peak, cmH2O, in one of the [`RHYTHMS`]: no faster than efforts can follow each other, nor than a
/// rate can be set.
pub fn patient(strength: f64, (share, duration_s): (f64, f64), settings: &Settings) -> PatientConfig {
    let fastest = f64::from(field("rate").max).min(60.0 / duration_s);
    PatientConfig {
        effort_cmh2o: strength,
        effort_rate_per_min: (share * f64::from(settings.rate)).min(fastest),
        effort_duration_s: duration_s,
        effort_variability_percent: VARIABILITY_PERCENT,
        ..PatientConfig::default()
    }
}

/// Runs and scores the breaths of one patient with one waveform.
fn run<C: ControlLaw + Clone>(
    job: &Job<'_, C>,
    rhythm: (f64, f64),
    plan: &Plan,
    settings: &Settings,
    seed: u64,
    sums: &mut Sums,
) -> Result<(), SourceError> {
    let bench = BenchConfig { patient: patient(job.strength, rhythm, settings), ..job.bench.clone() };
    let mut source = plan.source(&bench, job.controller.clone(), settings, seed)?;
    let planned = Breath::new(settings, plan.period_us)?;
    for number in 0..plan.warm_up + plan.breaths {
        let sum = &mut sums[usize::from(source.triggered())];
        let mut record = InspirationRecord::default();
        source.breathe(settings, &mut |tick| record.add_planned(tick, &planned))?;
        if number >= plan.warm_up {
            sum.breaths += 1;
            sum.score += record.score(settings, plan.period_us).score;
        }
    }
    Ok(())
}

/// Mean over the waveforms of the mean over the breaths of one kind.
fn score(waveforms: &[Sums], kind: usize) -> Option<f64> {
    let of_waveform = |sums: &Sums| {
        let Sum { breaths, score } = sums[kind];
        (breaths > 0).then(|| score / breaths as f64)
    };
    mean(waveforms.iter().map(of_waveform))
}

/// Mean of values that are all known; none of none.
fn mean(values: impl ExactSizeIterator<Item = Option<f64>>) -> Option<f64> {
    let count = values.len();
    let sum = values.sum::<Option<f64>>()?;
    (count > 0).then(|| sum / count as f64)
}
