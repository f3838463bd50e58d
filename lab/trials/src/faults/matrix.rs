//! The fault matrix: every case on every lung, and whether its row passes.

use std::sync::Mutex;

use serde::Serialize;
use shared::breath::{PAPER_PIPS, paper_settings};
use shared::safety::alarms::{Action, Fault, Priority};
use shared::safety::monitors::Monitors;
use shared::settings::Settings;

use super::cases::{BREATH_MS, FaultCase, LIMIT, Required, cases};
use super::hostile::sound_controller;
use super::injection::Injection;
use super::trial::{Trial, TrialOutcome, run};
use super::volume::Ventilation;
use plant::bench::BenchConfig;
use plant::locked;
use progress::{Progress, Stage};
use score::evaluate::side_by_side;
use ventilator::SourceError;

/// Injecting faults: cells of the matrix.
pub const FAULTS: Stage = Stage("inject faults");

/// Longest time from crossing the limit to the venting command, ms.
pub const VENT_WITHIN_MS: u32 = 200;
/// Longest time from the venting command to a pressure near PEEP if the valves obey, ms: two breaths.
pub const BACK_WITHIN_MS: u32 = 2 * BREATH_MS;
/// Number of breaths of a fault-free run.
const NOMINAL_BREATHS: u32 = 10;

/// Result of a fault on a lung.
#[derive(Clone, Debug, Serialize)]
pub struct FaultRow {
    /// The fault.
    pub fault: &'static str,
    /// The lung.
    pub lung: String,
    /// The monitors that must fire.
    pub monitor: Vec<&'static str>,
    /// Longest time over the seeds to the first of these alarms, ms; `None` if an alarm was missing under any seed.
    pub detect_ms: Option<u32>,
    /// Longest time that it may take, ms.
    pub detect_allowed_ms: u32,
    /// The last action taken.
    pub action: Option<Action>,
    /// Highest true airway pressure after the fault, cmH2O.
    pub peak_true: f64,
    /// Highest true airway pressure allowed, cmH2O.
    pub peak_allowed: f64,
    /// Longest time from venting to a pressure near PEEP, ms.
    pub back_at_peep_ms: Option<u32>,
    /// Longest time of readings above the limit without the command to vent, ms.
    pub limit_to_vent_ms: Option<u32>,
    /// Breaths that the lung got after the fault, at least over the seeds.
    pub breaths_delivered: u32,
    /// Longest time after the fault from the end of a delivered inspiration to the next one, s.
    pub longest_gap_s: f64,
    /// The same that is allowed, s; `None` if no ventilation is required.
    pub gap_allowed_s: Option<f64>,
    /// Volume that the lung got after the fault, as a share of a run with a sound machine.
    pub minute_volume_share: f64,
    /// The same that is required; `None` if no ventilation is.
    pub share_required: Option<f64>,
    /// The last response, in words; `refused` if it is that to another host's requests.
    pub response: &'static str,
    /// All alarms in order, under the first seed that shows a failure, or else under the last seed.
    pub alarms: Vec<&'static str>,
    /// Whether all requirements are met.
    pub pass: bool,
}

/// Runs this number of breaths, shared between the lungs, with effort and coughs but no fault, under the PID that is
/// best for all the paper's lungs; returns the alarms.
///
/// # Errors
/// A bench that is refused, or the request to stop.
pub fn false_alarms(
    lungs: &[BenchConfig],
    breaths: u32,
    progress: &Progress<'_>,
) -> Result<Vec<(String, Fault)>, SourceError> {
    let controller = &sound_controller()?;
    let each = breaths.div_ceil(lungs.len().max(1) as u32);
    let runs: Vec<(u64, BenchConfig)> = (0..u64::from(each / NOMINAL_BREATHS))
        .flat_map(|seed| lungs.iter().map(move |lung| (seed, lively(lung, seed))))
        .collect();
    let task = progress.task(FAULTS, runs.len());
    let found = side_by_side(&runs, &task, |(seed, bench)| {
        let outcome = run(&Trial {
            bench,
            settings: paper_settings(PAPER_PIPS[*seed as usize % PAPER_PIPS.len()]),
            controller,
            monitors: Monitors::ALL,
            injection: Injection::Controller,
            onset_ms: 0,
            watched_ms: NOMINAL_BREATHS * BREATH_MS,
            judged_after_ms: 0,
            seed: *seed,
        })?;
        let alarms = outcome.alarms.iter().map(|(fault, _)| (bench.name.clone(), *fault));
        Ok(alarms.collect::<Vec<_>>())
    })?;
    Ok(found.concat())
}

/// A random unit of the fleet, with a patient who breathes and coughs.
fn lively(lung: &BenchConfig, seed: u64) -> BenchConfig {
    let mut bench = lung.clone();
    bench.unit.number = seed as u32;
    bench.patient.effort_cmh2o = [0.0, 3.0, 6.0][seed as usize % 3];
    bench.patient.effort_rate_per_min = 11.0 + (seed % 7) as f64;
    bench.patient.cough_cmh2o = 20.0;
    bench.patient.cough_at_s = 9.0 + 0.137 * (seed % 90) as f64;
    bench
}

/// Runs every case on every lung under every seed, with a pressure limit in cmH2O.
///
/// # Errors
/// A bench that is refused, or the request to stop.
pub fn matrix(
    lungs: &[BenchConfig],
    seeds: &[u64],
    limit: f32,
    monitors: Monitors,
    progress: &Progress<'_>,
) -> Result<Vec<FaultRow>, SourceError> {
    let cells: Vec<_> = cells(lungs).collect();
    let task = progress.task(FAULTS, cells.len());
    let sound = SoundRuns::default();
    side_by_side(&cells, &task, |(case, lung)| cell(case, lung, seeds, (limit, monitors), &sound))
}

/// Every case with every lung in which its fault is possible, in the order of the matrix.
pub(super) fn cells(lungs: &[BenchConfig]) -> impl Iterator<Item = (&'static FaultCase, &BenchConfig)> {
    cases()
        .flat_map(|case| lungs.iter().map(move |lung| (case, lung)))
        .filter(|(case, lung)| case.is_possible(lung))
}

/// Runs without a fault, shared by all cases with the same settings and times.
#[derive(Default)]
pub(super) struct SoundRuns(Mutex<Vec<(SoundKey, Ventilation)>>);

/// What such a run depends on: lung, settings, times of the fault, of the judgement and of the end, ms, seed.
type SoundKey = (String, Settings, [u32; 3], u64);

impl SoundRuns {
    /// What the passive lung gets of a sound machine in the time of a trial.
    fn of(&self, trial: &Trial<'_>) -> Result<Ventilation, SourceError> {
        let times = [trial.onset_ms, trial.judged_after_ms, trial.watched_ms];
        let key = (trial.bench.name.clone(), trial.settings, times, trial.seed);
        let known =
            |runs: &[(SoundKey, Ventilation)]| runs.iter().find(|(of, _)| *of == key).map(|run| run.1);
        if let Some(known) = known(&locked(&self.0)) {
            return Ok(known);
        }
        let controller = sound_controller()?;
        let outcome = run(&Trial {
            controller: &controller,
            monitors: Monitors::ALL,
            injection: Injection::Controller,
            ..trial.clone()
        })?;
        locked(&self.0).push((key, outcome.ventilation));
        Ok(outcome.ventilation)
    }
}

/// Runs a case on a lung under every seed, with a pressure limit in cmH2O and some of the monitors.
pub(super) fn cell(
    case: &FaultCase,
    lung: &BenchConfig,
    seeds: &[u64],
    (limit, monitors): (f32, Monitors),
    sound: &SoundRuns,
) -> Result<FaultRow, SourceError> {
    let controller = case.controller.controller()?;
    let bench = case.bench(lung);
    let trial = |seed: u64| Trial {
        bench: &bench,
        settings: case.settings_for(lung, limit),
        controller: &controller,
        monitors,
        injection: case.injection,
        onset_ms: case.onset_ms,
        watched_ms: case.watched_ms,
        judged_after_ms: case.judged_after_ms,
        seed,
    };
    let passive = |seed: u64| {
        let trial = trial(seed);
        Trial { bench: lung, settings: case.injection.settings(trial.settings), ..trial }
    };
    let outcomes = seeds.iter().map(|seed| run(&trial(*seed))).collect::<Result<Vec<_>, _>>()?;
    let sound = seeds.iter().map(|seed| sound.of(&passive(*seed))).collect::<Result<Vec<_>, _>>()?;
    Ok(row(case, lung, limit, &outcomes, &sound))
}

/// The alarms that a case requires at a pressure limit, cmH2O: at a limit above the usual one the pressure of a soft lung stays
/// below it.
fn required(case: &FaultCase, limit: f32) -> impl Iterator<Item = Fault> {
    case.monitors.iter().copied().filter(move |fault| limit <= LIMIT || *fault != Fault::HighPressure)
}

fn row(
    case: &FaultCase,
    lung: &BenchConfig,
    limit: f32,
    outcomes: &[TrialOutcome],
    sound: &[Ventilation],
) -> FaultRow {
    let longest = |of: &dyn Fn(&TrialOutcome) -> Option<u32>| outcomes.iter().filter_map(of).max();
    let detected = |outcome: &TrialOutcome| outcome.time_to(required(case, limit).next()?);
    let fired =
        |outcome: &TrialOutcome| required(case, limit).all(|monitor| outcome.time_to(monitor).is_some());
    let unwanted = |(fault, _): &(Fault, u32)| {
        case.never.contains(fault) || (case.quiet && fault.alarm().priority == Priority::High)
    };
    let always = outcomes.iter().all(fired);
    let shown = outcomes
        .iter()
        .find(|outcome| !fired(outcome) || outcome.alarms.iter().any(unwanted))
        .or(outcomes.last());
    let peak_true = outcomes.iter().map(|outcome| outcome.peak_true).fold(0.0, f64::max);
    let limit_to_vent_ms = longest(&|outcome| outcome.limit_to_vent_ms);
    let back_at_peep_ms = longest(&|outcome| outcome.back_at_peep_ms);
    let detect_ms = if always { longest(&detected) } else { None };
    let back = |outcome: &TrialOutcome| {
        outcome.vented_ms.is_none() || outcome.back_at_peep_ms.is_some_and(|ms| ms <= BACK_WITHIN_MS)
    };
    let gap_ms = outcomes.iter().map(|outcome| outcome.ventilation.longest_gap_ms).max().unwrap_or(0);
    let share = |(outcome, sound): (&TrialOutcome, &Ventilation)| outcome.ventilation.volume / sound.volume;
    let minute_volume_share = outcomes.iter().zip(sound).map(share).fold(f64::INFINITY, f64::min);
    let ventilated = match case.ventilation {
        Required::Impossible => true,
        Required::GoesOn | Required::Resumes => {
            gap_ms <= case.longest_gap_ms(limit) && minute_volume_share >= case.least_share
        }
        Required::Stays => outcomes.iter().all(|outcome| outcome.ventilation.breaths == 0),
    };
    let goes_on = matches!(case.ventilation, Required::GoesOn | Required::Resumes);
    let peak_allowed = case.peak_allowed(limit);
    let quiet = !outcomes.iter().any(|outcome| outcome.alarms.iter().any(unwanted));
    let action = outcomes.last().and_then(TrialOutcome::action);
    let refused = outcomes.iter().all(|outcome| outcome.refused);
    FaultRow {
        fault: case.name,
        lung: lung.name.clone(),
        monitor: required(case, limit).map(|monitor| monitor.alarm().id).collect(),
        detect_ms,
        detect_allowed_ms: case.within_ms,
        action,
        breaths_delivered: outcomes.iter().map(|outcome| outcome.ventilation.breaths).min().unwrap_or(0),
        longest_gap_s: f64::from(gap_ms) * 1e-3,
        gap_allowed_s: goes_on.then(|| f64::from(case.longest_gap_ms(limit)) * 1e-3),
        minute_volume_share,
        share_required: goes_on.then_some(case.least_share),
        response: action.map_or(if refused { "refused" } else { "none" }, Action::name),
        peak_true,
        peak_allowed,
        back_at_peep_ms,
        limit_to_vent_ms,
        alarms: shown.iter().flat_map(|outcome| &outcome.alarms).map(|(fault, _)| fault.alarm().id).collect(),
        pass: always
            && peak_true <= peak_allowed
            && limit_to_vent_ms.is_none_or(|ms| ms <= VENT_WITHIN_MS)
            && detect_ms.is_none_or(|ms| ms <= case.within_ms)
            && (!case.obeys || outcomes.iter().all(back))
            && ventilated
            && quiet
            && (refused || case.injection != Injection::OtherHost),
    }
}
