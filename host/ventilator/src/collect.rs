//! Safe data collection: a known-good controller, the paper's random perturbations, and a pressure limit that ends the
//! breath (Suo et al. 2021, section 4).

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};
use shared::breath::PAPER_PIPS;
use shared::explore::{Exploration, ExplorationError};
use shared::safety::alarms::Fault;
use shared::settings::{LIMIT_MARGIN, Settings};
use shared::ventilator::opening;
use thiserror::Error;

use crate::{Source, SourceError, Tick};
use data::provenance::Provenance;
use data::recording::{DatasetError, Extra, Recording, Row, phase_number};
use plant::prescriptions::Prescriptions;
use progress::{Progress, Stage};

/// Recording: complete breaths.
pub const COLLECT: Stage = Stage("collect breaths");

/// Columns that only a bench fills; unused ones are removed at the end.
const TRUTH: [Extra; 2] = [Extra::PressureTrue, Extra::PressureSensorTrue];

/// Breaths with the same drawn prescription: a lung that empties slowly needs some until its breaths repeat.
pub const IN_A_ROW: usize = 4;
/// Lowest pressure limit of a drawn prescription, cmH2O: perturbations go further above PIP than a patient's limit allows.
const LIMIT: f32 = 60.0;

/// Configuration of a collection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CollectConfig {
    /// Number of breaths to record.
    pub breaths: usize,
    /// PIPs of every second breath, in turn, cmH2O.
    pub pips: Vec<f32>,
    /// Range from which the PIPs of the other breaths are drawn uniformly, cmH2O.
    pub pip_range: (f32, f32),
    /// Template of all settings except PIP.
    pub settings: Settings,
    /// Prescriptions to draw by turns with these PIPs and settings, for [`IN_A_ROW`] breaths each.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prescriptions: Option<Prescriptions>,
    /// Perturbations; `None` records the controller alone.
    pub exploration: Option<Exploration>,
    /// Number of breaths ended by the pressure limit after which collection gives up.
    pub aborts: usize,
    /// Seed of PIPs and perturbations.
    pub seed: u64,
}

impl Default for CollectConfig {
    fn default() -> Self {
        Self {
            breaths: 200,
            pips: PAPER_PIPS.to_vec(),
            pip_range: (8.0, 37.0),
            settings: Settings::default(),
            prescriptions: None,
            exploration: Some(Exploration::default()),
            aborts: 20,
            seed: 0,
        }
    }
}

/// Why a collection cannot continue.
#[derive(Debug, Error)]
pub enum CollectError {
    /// The exploration is not valid.
    #[error(transparent)]
    Exploration(#[from] ExplorationError),
    /// The list of PIPs is empty.
    #[error("the list of PIPs is empty: give at least one with --pips")]
    NoPips,
    /// The range of random PIPs does not fit PEEP and the pressure limit.
    #[error(
        "random PIPs from {0} to {1} cmH2O: the range must rise from PEEP and stay {LIMIT_MARGIN} cmH2O below the pressure limit"
    )]
    PipRange(f32, f32),
    /// The settings cannot be stored in the recording.
    #[error("cannot store the settings of the collection: {0}")]
    Provenance(serde_json::Error),
    /// The source failed before anything was recorded.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A breath cannot be saved.
    #[error("cannot save a breath: {0}")]
    Keep(#[from] DatasetError),
    /// The source failed during the recording.
    #[error("{reason}")]
    Interrupted {
        /// The failure.
        reason: SourceError,
        /// The recording up to the failure.
        collected: Box<Collected>,
    },
}

/// A recording, with its counts of breaths.
#[derive(Clone, Debug)]
pub struct Collected {
    /// The recording, including breaths that were ended early.
    pub recording: Recording,
    /// Number of complete breaths.
    pub breaths: usize,
    /// Number of breaths ended by the pressure limit.
    pub aborts: usize,
}

/// Records breaths from a source.
///
/// If the ventilator enters its safe state, the part of the breath so far is kept, and collection continues after an
/// acknowledgement, up to the limit on such breaths. A request to stop takes effect after a breath.
///
/// # Errors
/// An invalid configuration, or a source that fails for a reason other than a ventilator fault; the error contains the
/// recording up to then.
pub fn collect<C: Clone>(
    source: &mut dyn Source<C>,
    controller: &C,
    config: &CollectConfig,
    progress: &Progress<'_>,
) -> Result<Collected, CollectError> {
    let recording = Recording::with_extras(provenance(source, config)?, &TRUTH);
    let mut collected = Collected { recording, breaths: 0, aborts: 0 };
    let keep = &mut |breath: &RecordedBreath| {
        collected.add(breath);
        Ok(())
    };
    let outcome = collect_from(source, controller, config, Position::default(), progress, keep);
    collected.recording.provenance.notes.extend(source.shortfalls());
    collected.recording.leave_out_unknown();
    match outcome {
        Err(CollectError::Source(reason)) if !collected.recording.is_empty() => {
            let number = collected.breaths + collected.aborts;
            let notes = &mut collected.recording.provenance.notes;
            notes.push(format!("the recording ended in breath {number}: {reason}"));
            Err(CollectError::Interrupted { reason, collected: Box::new(collected) })
        }
        outcome => outcome.map(|()| collected),
    }
}

impl Collected {
    fn add(&mut self, breath: &RecordedBreath) {
        breath.rows.iter().for_each(|row| self.recording.push(*row));
        match breath.ending {
            BreathEnding::Complete => self.breaths += 1,
            BreathEnding::Fault(fault) => {
                self.aborts += 1;
                let number = breath.number;
                self.recording.provenance.notes.push(format!("breath {number} ended early: {fault:?}"));
            }
            BreathEnding::Source => {}
        }
    }
}

/// How far a collection has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    /// Number of complete breaths.
    pub breaths: usize,
    /// Number of breaths ended by the pressure limit.
    pub aborts: usize,
    /// Number of sessions before this one, which ended before the collection was complete.
    pub sessions: u32,
}

/// A recorded breath, or the part of one that was recorded.
#[derive(Clone, Debug)]
pub struct RecordedBreath {
    /// Its number, breaths that ended early included.
    pub number: u32,
    /// Its ticks.
    pub rows: Vec<Row>,
    /// How it ended.
    pub ending: BreathEnding,
}

/// How a recorded breath ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BreathEnding {
    /// With its last tick.
    Complete,
    /// With this fault; the breath is repeated.
    Fault(Fault),
    /// The source failed.
    Source,
}

/// Records the breaths of a collection from a position on and passes each to `keep`, so that a collection survives a source that
/// fails. Every session has perturbations of its own; PIPs are those of the whole collection.
///
/// # Errors
/// An invalid configuration, a source that fails for a reason other than a ventilator fault, or an error of `keep`.
pub fn collect_from<C: Clone>(
    source: &mut dyn Source<C>,
    controller: &C,
    config: &CollectConfig,
    from: Position,
    progress: &Progress<'_>,
    keep: &mut dyn FnMut(&RecordedBreath) -> Result<(), DatasetError>,
) -> Result<(), CollectError> {
    check(config)?;
    let plan = plan(config);
    let Position { mut breaths, mut aborts, sessions } = from;
    let exploration = |aborts: usize| exploration(config, u64::from(sessions) << 16 | aborts as u64);
    let task = progress.task(COLLECT, config.breaths);
    task.reach(breaths);
    if breaths >= config.breaths {
        return Ok(());
    }
    source.configure(controller.clone(), exploration(aborts))?;
    source.upcoming(&plan[breaths..])?;
    while breaths < config.breaths && aborts <= config.aborts && !task.stopped() {
        let (number, settings) = ((breaths + aborts) as u32, plan[breaths]);
        let mut rows = Vec::new();
        let result = source.breath(&settings, &mut |tick| rows.push(row(tick, number, &settings)));
        let ending = match &result {
            Ok(()) => BreathEnding::Complete,
            Err(SourceError::Fault { fault, .. }) => BreathEnding::Fault(*fault),
            Err(_) => BreathEnding::Source,
        };
        keep(&RecordedBreath { number, rows, ending })?;
        match ending {
            BreathEnding::Complete => {
                breaths += 1;
                task.advance(1);
            }
            BreathEnding::Fault(_) => {
                aborts += 1;
                source.acknowledge()?;
                source.configure(controller.clone(), exploration(aborts))?;
                source.upcoming(&plan[breaths..])?;
            }
            BreathEnding::Source => result?,
        }
    }
    Ok(())
}

fn check(config: &CollectConfig) -> Result<(), CollectError> {
    if let Some(exploration) = &config.exploration {
        exploration.validate()?;
    }
    if config.pips.is_empty() {
        return Err(CollectError::NoPips);
    }
    let (low, high) = config.pip_range;
    if !(low >= config.settings.peep && low < high && high + LIMIT_MARGIN <= config.settings.pressure_limit) {
        return Err(CollectError::PipRange(low, high));
    }
    Ok(())
}

/// Settings of every breath. A breath ended by the pressure limit is repeated.
fn plan(config: &CollectConfig) -> Vec<Settings> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let mut listed = |breath: usize| Settings { pip: pip(config, breath, &mut rng), ..config.settings };
    let settings = |breath: usize| match &config.prescriptions {
        Some(prescriptions) if !(breath / IN_A_ROW).is_multiple_of(2) => {
            let drawn = prescriptions.draw(config.seed, (breath / IN_A_ROW) as u32);
            Settings { pressure_limit: drawn.pressure_limit.max(LIMIT), ..drawn }
        }
        _ => listed(breath),
    };
    (0..config.breaths).map(settings).collect()
}

/// Every second breath has a listed PIP, in turn; the others a random one.
fn pip(config: &CollectConfig, breath: usize, rng: &mut ChaCha8Rng) -> f32 {
    if breath.is_multiple_of(2) {
        config.pips[breath / 2 % config.pips.len()]
    } else {
        rng.random_range(config.pip_range.0..config.pip_range.1)
    }
}

/// The exploration after restarts, which reset the count of breaths: another seed avoids repeated perturbations.
fn exploration(config: &CollectConfig, restart: u64) -> Option<Exploration> {
    config.exploration.map(|exploration| Exploration {
        seed: exploration.seed ^ config.seed.rotate_left(20) ^ restart.rotate_left(48),
        ..exploration
    })
}

fn provenance<C>(source: &dyn Source<C>, config: &CollectConfig) -> Result<Provenance, CollectError> {
    Ok(Provenance {
        seed: config.seed,
        plant: source.plant(),
        plant_parameters: source.plant_parameters(),
        settings: serde_json::to_value(config).map_err(CollectError::Provenance)?,
        ..Provenance::new(source.period_us(), "collect")
    })
}

fn row(tick: &Tick, breath: u32, settings: &Settings) -> Row {
    let sample = &tick.sample;
    Row {
        breath,
        tick: sample.tick,
        phase: phase_number(sample.phase),
        target: sample.target,
        pressure: sample.pressure,
        u_in: sample.u_in,
        u_out: opening(sample.u_out),
        explore: sample.explore,
        pip: settings.pip,
        peep: settings.peep,
        pressure_true: tick.truth.map(|truth| truth.airway_pressure),
        pressure_sensor_true: tick.truth.map(|truth| truth.sensor_pressure),
        ..Row::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BenchSource;
    use plant::bench::BenchConfig;
    use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
    use shared::control::Controller;
    use shared::control::pid::{Pid, PidGains};
    use std::sync::atomic::AtomicBool;

    fn controller(p: f32) -> Controller {
        Controller::Pid(Pid::new(PidGains { p, i: 10.0, d: 0.0 }, DEFAULT_PERIOD_US).unwrap())
    }

    fn run(config: &CollectConfig, p: f32) -> Result<Collected, CollectError> {
        run_on(&BenchConfig::paper(20.0, 20.0), config, p)
    }

    fn run_on(lung: &BenchConfig, config: &CollectConfig, p: f32) -> Result<Collected, CollectError> {
        let mut source =
            BenchSource::new(lung, controller(p), &paper_settings(20.0), DEFAULT_PERIOD_US, config.seed)
                .unwrap();
        collect(&mut source, &controller(p), config, &Progress::silent())
    }

    #[test]
    fn every_breath_is_recorded_whole_and_valid() {
        let collected = run(&CollectConfig { breaths: 6, ..CollectConfig::default() }, 1.0).unwrap();
        assert_eq!((collected.breaths, collected.aborts), (6, 0));
        assert_eq!(collected.recording.len(), 6 * 3000);
        assert_eq!(collected.recording.inspirations().len(), 6);
        collected.recording.validate().unwrap();
        assert!(collected.recording.explore.iter().any(|x| x.abs() > 1.0));
    }

    #[test]
    fn listed_and_drawn_prescriptions_take_turns() {
        let prescriptions = Prescriptions::find("bedside").unwrap();
        let config =
            CollectConfig { breaths: 40, prescriptions: Some(prescriptions), ..CollectConfig::default() };
        for (number, block) in plan(&config).chunks(IN_A_ROW).enumerate() {
            let listed = block.iter().all(|breath| Settings { pip: 20.0, ..*breath } == config.settings);
            assert_eq!(listed, number % 2 == 0, "block {number}");
            assert!(listed || block.iter().all(|breath| breath == &block[0]));
            assert!(block.iter().all(|breath| breath.validate().is_ok() && breath.pressure_limit >= LIMIT));
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_recording() {
        let config = CollectConfig { breaths: 3, seed: 4, ..CollectConfig::default() };
        assert_eq!(run(&config, 1.0).unwrap().recording, run(&config, 1.0).unwrap().recording);
        let other = CollectConfig { seed: 5, ..config.clone() };
        assert_ne!(run(&config, 1.0).unwrap().recording.u_in, run(&other, 1.0).unwrap().recording.u_in);
    }

    #[test]
    fn the_pressure_limit_ends_the_breath_and_collection_goes_on() {
        let violent = Exploration {
            boundary_probability: 0.5,
            boundary_height: (95.0, 100.0),
            boundary_duration: (0.3, 0.3),
            ..Exploration::default()
        };
        let config = CollectConfig {
            breaths: 20,
            settings: Settings { pressure_limit: 42.0, ..Settings::default() },
            exploration: Some(violent),
            aborts: 200,
            ..CollectConfig::default()
        };
        let stiff = BenchConfig::paper(50.0, 10.0);
        let collected = run_on(&stiff, &config, 1.0).unwrap();
        assert!(collected.aborts > 0 && collected.breaths == 20, "{} aborts", collected.aborts);
        assert_eq!(collected.recording.inspirations().len(), 20);
        collected.recording.validate().unwrap();
        let highest = collected.recording.pressure.iter().copied().fold(0.0, f32::max);
        assert!(highest < 60.0, "{highest}");
        assert_eq!(collected.recording.provenance.notes.len(), collected.aborts);
    }

    #[test]
    fn a_wish_to_stop_keeps_what_is_there() {
        let stop = AtomicBool::new(true);
        let lung = BenchConfig::paper(20.0, 20.0);
        let mut source =
            BenchSource::new(&lung, controller(1.0), &paper_settings(20.0), DEFAULT_PERIOD_US, 0).unwrap();
        let config = CollectConfig::default();
        let collected = collect(&mut source, &controller(1.0), &config, &Progress::quiet(&stop)).unwrap();
        assert_eq!(collected.breaths, 0);
    }

    #[test]
    fn impossible_plans_are_refused() {
        let no_pips = CollectConfig { pips: Vec::new(), ..CollectConfig::default() };
        assert!(matches!(run(&no_pips, 1.0), Err(CollectError::NoPips)));
        let too_high = CollectConfig { pip_range: (10.0, 58.0), ..CollectConfig::default() };
        assert!(matches!(run(&too_high, 1.0), Err(CollectError::PipRange(..))));
    }
}
