//! The fault matrix: every fault on every lung, with the monitor that must fire.

use std::sync::Mutex;

use serde::Serialize;
use shared::breath::{DEFAULT_PERIOD_US, PAPER_PIPS, paper_settings};
use shared::control::Controller;
use shared::control::features::FeatureSpec;
use shared::control::network::Network;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::{Residual, ResidualSpec};
use shared::safety::alarms::{Action, Fault};
use shared::safety::monitors::Monitors;
use shared::settings::Settings;

use super::injection::Damage;
use super::injection::Injection::{
    self, BothLost, BrownOut, Coughs, Drift, Dropped, FlowLost, Hang, HostSilent, MissedTicks, Noise,
    NoisyAt, Offset, OtherHost, OutletLost, Reads, StuckAt, StuckAtLast, SwappedBytes, Weights,
};
use super::trial::{Trial, TrialOutcome, run};
use super::volume::Ventilation;
use crate::evaluate::side_by_side;
use plant::bench::{BenchConfig, Failure};
use plant::locked;
use progress::{Progress, Stage};
use ventilator::SourceError;

/// Pressure limit of all trials, cmH2O.
pub const LIMIT: f32 = 40.0;
/// PIP of all trials, cmH2O.
const PIP: f32 = 25.0;
/// Longest time from crossing the limit to the venting command, ms.
pub const VENT_WITHIN_MS: u32 = 200;
/// Highest true pressure if the valves obey, and if one of them is stuck, cmH2O.
pub const PEAKS: (f64, f64) = (60.0, 75.0);
/// In the middle of the third inspiration, ms.
const MID_INSPIRATION_MS: u32 = 6400;
/// Just before the fourth inspiration, ms.
const BEFORE_MS: u32 = 8900;
/// In the middle of the second inspiration at 4 breaths a minute, ms.
const SLOW_INSPIRATION_MS: u32 = 15_500;
/// A breath at the usual rate, ms.
const BREATH_MS: u32 = 3000;
/// Longest time from the venting command to a pressure near PEEP if the valves obey, ms: two breaths.
const BACK_WITHIN_MS: u32 = 2 * BREATH_MS;
/// Smallest share of the sound machine's minute volume that must remain.
pub const VOLUME_SHARE: f64 = 0.8;
/// Longest gap without a delivered breath: two breaths; after a reset 3 s, ms.
const GAP_MS: u32 = 2 * BREATH_MS;
const GAP_AFTER_RESET_MS: u32 = 3000;
/// Number of breaths of a fault-free run.
const NOMINAL_BREATHS: u32 = 10;
/// Duration of a trial after its fault, ms.
const WATCHED_MS: u32 = 21_000;

use CaseController::{Alternating, Greedy, Ringing, Sound};

/// The controller of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CaseController {
    /// The PID that is best for all the paper's lungs.
    Sound,
    /// A PID that rings on every lung.
    Ringing,
    /// A network that always requests 100 % more.
    Greedy,
    /// A network that alternates between 100 % more and 100 % less.
    Alternating,
}

/// A fault and the expected reaction.
#[derive(Clone, Copy, Debug)]
pub struct FaultCase {
    /// Name in tables.
    pub name: &'static str,
    /// The injected fault.
    pub injection: Injection,
    /// The alarms that must occur; if empty, only the pressure is judged.
    pub monitors: &'static [Fault],
    controller: CaseController,
    onset_ms: u32,
    settings: fn() -> Settings,
    /// Highest true airway pressure after it, cmH2O.
    pub peak_allowed: f64,
    /// Longest time until the first of the monitors fires, ms.
    within_ms: u32,
    /// Duration of the trial after the fault, ms.
    watched_ms: u32,
    /// What ventilation must go on.
    ventilation: Required,
    /// Lowest resistance of a lung with which the fault is possible, cmH2O/(L/s).
    least_resistance: f64,
}

/// Ventilation that a row requires after its fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Required {
    /// None: with this fault no command moves gas in and out, or breaths are cut at first.
    Impossible,
    /// No gap longer than [`GAP_MS`].
    Breaths,
    /// The same with the share [`VOLUME_SHARE`] and another longest gap, ms.
    GapWithin(u32),
}

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
    /// Volume that the lung got after the fault, as a share of a run with a sound machine.
    pub minute_volume_share: f64,
    /// The last response, in words.
    pub response: &'static str,
    /// All alarms in order, under the first seed that shows a failure, or else under the last seed.
    pub alarms: Vec<&'static str>,
    /// Whether all requirements are met.
    pub pass: bool,
}

fn usual() -> Settings {
    Settings { pressure_limit: LIMIT, ..paper_settings(PIP) }
}

/// Settings with a pressure limit that a cough exceeds on every lung.
fn tight() -> Settings {
    Settings { pressure_limit: PIP + 8.0, ..usual() }
}

/// Settings with a limit that a controller can reach on every lung.
fn low() -> Settings {
    Settings { pip: 12.0, pressure_limit: 17.0, ..usual() }
}

/// Settings with a PEEP whose loss shows on every lung.
fn high_peep() -> Settings {
    Settings { peep: 10.0, pip: 30.0, ..usual() }
}

/// Settings with four breaths a minute.
fn slow() -> Settings {
    Settings { rate: 4.0, ..usual() }
}

const fn case(name: &'static str, injection: Injection, monitors: &'static [Fault]) -> FaultCase {
    FaultCase {
        name,
        injection,
        monitors,
        controller: Sound,
        onset_ms: MID_INSPIRATION_MS,
        settings: usual,
        peak_allowed: PEAKS.0,
        within_ms: WATCHED_MS,
        watched_ms: WATCHED_MS,
        ventilation: Required::GapWithin(GAP_MS),
        least_resistance: 0.0,
    }
}

/// A part of the machine that fails.
const fn part(name: &'static str, failure: Failure, monitors: &'static [Fault]) -> FaultCase {
    case(name, Injection::Part(failure), monitors)
}

/// A valve that no longer obeys.
const fn stuck(name: &'static str, failure: Failure, monitors: &'static [Fault]) -> FaultCase {
    FaultCase { peak_allowed: PEAKS.1, ..part(name, failure, monitors) }
}

impl FaultCase {
    const fn at(self, onset_ms: u32) -> Self {
        Self { onset_ms, ..self }
    }

    /// Requires detection before the next breath ends.
    const fn within_a_breath(self) -> Self {
        Self { within_ms: BREATH_MS, ..self }
    }

    /// Requires no ventilation: no command moves gas, or every breath is cut until the ladder has replaced the controller.
    const fn not_ventilated(self) -> Self {
        Self { ventilation: Required::Impossible, ..self }
    }

    /// Watches for longer, which is how long the monitors may take.
    const fn watched(self, watched_ms: u32) -> Self {
        Self { watched_ms, within_ms: watched_ms, ..self }
    }

    /// Requires that breaths go on, of whatever volume.
    const fn of_any_volume(self) -> Self {
        Self { ventilation: Required::Breaths, ..self }
    }

    /// Leaves out lungs with a lower resistance, cmH2O/(L/s): in them no flow of the valve's raises the pressure so far.
    const fn with_resistance(self, least_resistance: f64) -> Self {
        Self { least_resistance, ..self }
    }

    const fn resumed(self) -> Self {
        Self { ventilation: Required::GapWithin(GAP_AFTER_RESET_MS), ..self }
    }

    const fn with(self, settings: fn() -> Settings) -> Self {
        Self { settings, ..self }
    }

    const fn run_by(self, controller: CaseController) -> Self {
        Self { controller, ..self }
    }
}

/// Faults of the sensor.
const SENSOR: [FaultCase; 17] = [
    case("reading stuck at its last value", StuckAtLast, &[Fault::ReadingFrozen]),
    case("reading stuck at PEEP", StuckAt(5.0), &[Fault::ReadingFrozen]).at(BEFORE_MS).within_a_breath(),
    case("reading stuck at 0", StuckAt(0.0), &[Fault::ReadingFrozen]).at(BEFORE_MS).within_a_breath(),
    case("reading stuck at PEEP with normal noise", NoisyAt(5.0), &[Fault::SensorsDisagree])
        .at(BEFORE_MS)
        .within_a_breath(),
    case("reading is not a number", Reads(f32::NAN), &[Fault::ReadingNotANumber]),
    case("reading is infinite", Reads(f32::INFINITY), &[Fault::ReadingOutOfRange]),
    case("reading drifts up by 1 cmH2O/s", Drift(1.0), &[Fault::SensorsDisagree]),
    case("reading drifts down by 1 cmH2O/s", Drift(-1.0), &[Fault::SensorsDisagree]),
    case("reading is 5 cmH2O too high", Offset(5.0), &[Fault::SensorsDisagree]),
    case("reading is 5 cmH2O too low", Offset(-5.0), &[Fault::SensorsDisagree]),
    case("sensor noise ten times higher", Noise(1.0), &[Fault::ReadingNoisy]),
    case("one third of the readings lost", Dropped(0.33), &[Fault::ReadingNotANumber]),
    case("bytes swapped in one third of the readings", SwappedBytes(0.33), &[Fault::ReadingJumps]),
    case("outlet sensor lost", OutletLost, &[Fault::OutletSensorLost]),
    case("both pressure sensors lost", BothLost, &[Fault::BackupVentilation]),
    case("both pressure sensors lost before a breath", BothLost, &[Fault::BackupVentilation]).at(BEFORE_MS),
    case("flow sensor lost", FlowLost, &[]),
];

/// Faults of machine and breathing circuit.
const MACHINE: [FaultCase; 17] = [
    part("tube occluded", Failure::TubeOccluded, &[Fault::Occlusion]).at(BEFORE_MS).not_ventilated(),
    stuck("expiratory filter clogged", Failure::FilterClogged, &[Fault::BaselineHigh]).not_ventilated(),
    part("patient disconnected", Failure::Disconnected, &[Fault::Disconnection]).not_ventilated(),
    case("patient disconnected for 5 s", Injection::Reconnected(5000), &[Fault::Disconnection])
        .not_ventilated(),
    part("leak of 0.2 L/s", Failure::Leak(0.2), &[]).at(BEFORE_MS),
    part("leak of 0.5 L/s", Failure::Leak(0.5), &[]).at(BEFORE_MS),
    part("leak of 0.8 L/s", Failure::Leak(0.8), &[Fault::Leak]).at(BEFORE_MS),
    part("leak of 3 L/s from the start", Failure::Leak(3.0), &[Fault::LowPressure, Fault::BaselineLow])
        .at(0)
        .not_ventilated(),
    stuck(
        "inspiratory valve stuck open",
        Failure::InspiratoryValveStuck(80.0),
        &[Fault::BaselineHigh, Fault::HighPressure],
    )
    .not_ventilated(),
    stuck("inspiratory valve stuck closed", Failure::InspiratoryValveStuck(0.0), &[Fault::NoResponse])
        .not_ventilated(),
    stuck("expiratory valve stuck closed", Failure::ExpiratoryValveClosed, &[Fault::BaselineHigh])
        .not_ventilated(),
    stuck(
        "expiratory valve stuck closed at 4 breaths/min",
        Failure::ExpiratoryValveClosed,
        &[Fault::SustainedPressure],
    )
    .with(slow)
    .at(SLOW_INSPIRATION_MS)
    .watched(66_000)
    .not_ventilated(),
    stuck("both valves stuck", Failure::BothValvesStuck(80.0), &[Fault::HardLimit]).not_ventilated(),
    stuck("PEEP valve stuck at 15 cmH2O", Failure::PeepValveStuck(15.0), &[Fault::BaselineHigh]),
    stuck("PEEP valve stuck at 0", Failure::PeepValveStuck(0.0), &[Fault::BaselineLow]).with(high_peep),
    part("gas supply lost", Failure::SupplyLost, &[Fault::NoResponse]).not_ventilated(),
    case("cough in every breath", Coughs(25.0), &[]).with(tight),
];

/// Faults of chip and controller.
const CONTROL: [FaultCase; 12] = [
    case("10 of every 100 control ticks missed", MissedTicks(10), &[Fault::MissedTicks]),
    case("control task hangs", Hang, &[Fault::Restarted]).resumed(),
    case("power supply dips during an inspiration", BrownOut, &[Fault::Restarted]).resumed(),
    case("host goes silent during exploration", HostSilent, &[Fault::HostSilent]),
    case("a second host sends other settings and gains", OtherHost, &[]).of_any_volume(),
    case("one bit of the stored weights flipped", Weights(Damage::FlippedBit), &[Fault::WeightsRefused])
        .run_by(Greedy),
    case("power lost while weights are stored", Weights(Damage::TornStore), &[Fault::WeightsRefused])
        .run_by(Greedy),
    case("network that always requests 100 % more", Injection::Controller, &[]).run_by(Greedy),
    case("network that drives each breath to the limit", Injection::Controller, &[Fault::LearnedDistrusted])
        .with(low)
        .run_by(Greedy)
        .at(0)
        .not_ventilated(),
    case("PID that drives each breath to the limit", Injection::Controller, &[Fault::CommandCapped])
        .with(low)
        .run_by(Ringing)
        .with_resistance(20.0)
        .at(0)
        .not_ventilated(),
    case("network that alternates between fully open and closed", Injection::Controller, &[])
        .run_by(Alternating),
    case("oscillating PID", Injection::Controller, &[]).run_by(Ringing),
];

/// All faults.
pub fn cases() -> impl Iterator<Item = &'static FaultCase> {
    SENSOR.iter().chain(&MACHINE).chain(&CONTROL)
}

/// The PID that is best for all the paper's lungs.
pub(crate) const SOUND: PidGains = PidGains { p: 6.098, i: 290.6, d: 0.2094 };
/// The same without its integral, which would counteract a greedy network.
const WITHOUT_INTEGRAL: PidGains = PidGains { i: 0.0, ..SOUND };
/// Gains that ring on every lung.
const RINGING: PidGains = PidGains { p: 60.0, i: 3000.0, d: 0.0 };

impl CaseController {
    fn controller(self) -> Result<Controller, SourceError> {
        let pid = |gains| Pid::new(gains, DEFAULT_PERIOD_US).map(Controller::Pid);
        let built = match self {
            Sound => pid(SOUND).ok(),
            Ringing => pid(RINGING).ok(),
            Greedy => full_authority(WITHOUT_INTEGRAL, greedy()),
            Alternating => full_authority(SOUND, alternating()),
        };
        built.ok_or(SourceError::Stopped)
    }
}

/// A learned controller with full authority over a PID.
pub(super) fn full_authority(gains: PidGains, network: Network) -> Option<Controller> {
    let spec = ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains,
        lambda: 1.0,
        authority: 100.0,
        features: FeatureSpec::default(),
    };
    Residual::new(spec, network).ok().map(Controller::Residual)
}

fn greedy() -> Network {
    let mut network = Network::zero();
    network.output.bias[0] = 1.0;
    network
}

/// Requests nothing after a command above 50 %, everything after one below.
fn alternating() -> Network {
    let mut network = Network::zero();
    let last_command = shared::control::features::PAST_COMMANDS.start;
    network.hidden_1.weights[0][last_command] = 100.0;
    network.hidden_1.bias[0] = -100.0;
    network.hidden_2.weights[0][0] = 100.0;
    network.output.weights[0][0] = -2.0;
    network
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
    let controller = &Sound.controller()?;
    let each = breaths.div_ceil(lungs.len().max(1) as u32);
    let runs: Vec<(u64, BenchConfig)> = (0..u64::from(each / NOMINAL_BREATHS))
        .flat_map(|seed| lungs.iter().map(move |lung| (seed, lively(lung, seed))))
        .collect();
    let task = progress.task(Stage::Faults, runs.len());
    let found = side_by_side(&runs, &task, |(seed, bench)| {
        let outcome = run(&Trial {
            bench,
            settings: paper_settings(PAPER_PIPS[*seed as usize % PAPER_PIPS.len()]),
            controller,
            monitors: Monitors::ALL,
            injection: Injection::Controller,
            onset_ms: 0,
            watched_ms: NOMINAL_BREATHS * BREATH_MS,
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

/// Switches off each monitor in turn; returns the faults whose rows then fail. Without such a fault, a monitor is
/// unproven.
///
/// # Errors
/// See [`matrix`].
pub fn without_each_monitor(
    lungs: &[BenchConfig],
    seeds: &[u64],
    progress: &Progress<'_>,
) -> Result<Vec<(Fault, Vec<&'static str>)>, SourceError> {
    let missed = |monitor: Fault| {
        let progress = progress.of(monitor.alarm().id);
        let rows = matrix(lungs, seeds, Monitors::ALL.without(monitor), &progress)?;
        let mut failed: Vec<_> = rows.iter().filter(|row| !row.pass).map(|row| row.fault).collect();
        failed.dedup();
        Ok((monitor, failed))
    };
    Fault::all().map(missed).collect()
}

/// Runs every case on every lung under every seed.
///
/// # Errors
/// A bench that is refused, or the request to stop.
pub fn matrix(
    lungs: &[BenchConfig],
    seeds: &[u64],
    monitors: Monitors,
    progress: &Progress<'_>,
) -> Result<Vec<FaultRow>, SourceError> {
    let cells: Vec<_> = cases()
        .flat_map(|case| lungs.iter().map(move |lung| (case, lung)))
        .filter(|(case, lung)| lung.lung.first.resistance_cmh2o_per_l_s >= case.least_resistance)
        .collect();
    let task = progress.task(Stage::Faults, cells.len());
    let sound = SoundRuns::default();
    side_by_side(&cells, &task, |(case, lung)| cell(case, lung, seeds, monitors, &sound))
}

/// Runs without a fault, shared by all cases with the same settings and times.
#[derive(Default)]
struct SoundRuns(Mutex<Vec<(SoundKey, Ventilation)>>);

/// What such a run depends on: lung, settings, onset and end of the fault, ms, seed.
type SoundKey = (String, Settings, [u32; 2], u64);

impl SoundRuns {
    /// What the lung gets of a sound machine in the time of a trial.
    fn of(&self, trial: &Trial<'_>) -> Result<Ventilation, SourceError> {
        let times = [trial.onset_ms, trial.watched_ms];
        let key = (trial.bench.name.clone(), trial.settings, times, trial.seed);
        let known =
            |runs: &[(SoundKey, Ventilation)]| runs.iter().find(|(of, _)| *of == key).map(|run| run.1);
        if let Some(known) = known(&locked(&self.0)) {
            return Ok(known);
        }
        let controller = Sound.controller()?;
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

fn cell(
    case: &FaultCase,
    lung: &BenchConfig,
    seeds: &[u64],
    monitors: Monitors,
    sound: &SoundRuns,
) -> Result<FaultRow, SourceError> {
    let controller = case.controller.controller()?;
    let trial = |seed: u64| Trial {
        bench: lung,
        settings: (case.settings)(),
        controller: &controller,
        monitors,
        injection: case.injection,
        onset_ms: case.onset_ms,
        watched_ms: case.watched_ms,
        seed,
    };
    let outcomes = seeds.iter().map(|seed| run(&trial(*seed))).collect::<Result<Vec<_>, _>>()?;
    let sound = seeds.iter().map(|seed| sound.of(&trial(*seed))).collect::<Result<Vec<_>, _>>()?;
    Ok(row(case, lung, &outcomes, &sound))
}

fn row(case: &FaultCase, lung: &BenchConfig, outcomes: &[TrialOutcome], sound: &[Ventilation]) -> FaultRow {
    let longest = |of: &dyn Fn(&TrialOutcome) -> Option<u32>| outcomes.iter().filter_map(of).max();
    let detected = |outcome: &TrialOutcome| outcome.time_to(*case.monitors.first()?);
    let fired = |outcome: &TrialOutcome| case.monitors.iter().all(|m| outcome.time_to(*m).is_some());
    let always = outcomes.iter().all(fired);
    let shown = outcomes.iter().find(|outcome| !fired(outcome)).or(outcomes.last());
    let peak_true = outcomes.iter().map(|outcome| outcome.peak_true).fold(0.0, f64::max);
    let limit_to_vent_ms = longest(&|outcome| outcome.limit_to_vent_ms);
    let back_at_peep_ms = longest(&|outcome| outcome.back_at_peep_ms);
    let detect_ms = if always { longest(&detected) } else { None };
    let obey = case.peak_allowed < PEAKS.1;
    let back = |outcome: &TrialOutcome| {
        outcome.vented_ms.is_none() || outcome.back_at_peep_ms.is_some_and(|ms| ms <= BACK_WITHIN_MS)
    };
    let gap_ms = outcomes.iter().map(|outcome| outcome.ventilation.longest_gap_ms).max().unwrap_or(0);
    let share = |(outcome, sound): (&TrialOutcome, &Ventilation)| outcome.ventilation.volume / sound.volume;
    let minute_volume_share = outcomes.iter().zip(sound).map(share).fold(f64::INFINITY, f64::min);
    let ventilated = match case.ventilation {
        Required::Impossible => true,
        Required::Breaths => gap_ms <= GAP_MS,
        Required::GapWithin(ms) => {
            gap_ms <= ms.max(pause_ms(&(case.settings)())) && minute_volume_share >= VOLUME_SHARE
        }
    };
    let action = outcomes.last().and_then(TrialOutcome::action);
    FaultRow {
        fault: case.name,
        lung: lung.name.clone(),
        monitor: case.monitors.iter().map(|monitor| monitor.alarm().id).collect(),
        detect_ms,
        action,
        breaths_delivered: outcomes.iter().map(|outcome| outcome.ventilation.breaths).min().unwrap_or(0),
        longest_gap_s: f64::from(gap_ms) * 1e-3,
        minute_volume_share,
        response: action.map_or("none", Action::name),
        peak_true,
        peak_allowed: case.peak_allowed,
        back_at_peep_ms,
        limit_to_vent_ms,
        alarms: shown.iter().flat_map(|outcome| &outcome.alarms).map(|(fault, _)| fault.alarm().id).collect(),
        pass: always
            && peak_true <= case.peak_allowed
            && limit_to_vent_ms.is_none_or(|ms| ms <= VENT_WITHIN_MS)
            && detect_ms.is_none_or(|ms| ms <= case.within_ms)
            && (!obey || outcomes.iter().all(back))
            && ventilated,
    }
}

/// Longest gap at these settings without counting as one, ms: two breaths without their inspiration.
fn pause_ms(settings: &Settings) -> u32 {
    (1000.0 * (2.0 * 60.0 / settings.rate - settings.inspiratory_time)) as u32
}
