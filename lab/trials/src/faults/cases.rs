//! The rows of the fault matrix: a fault, the patient and the settings, and what must happen.

use shared::breath::paper_settings;
use shared::safety::alarms::Fault;
use shared::settings::Settings;

use super::hostile::CaseController::{self, Alternating, Greedy, Ringing, Sound};
use super::injection::Damage;
use super::injection::Injection::{
    self, BothLost, BothLostAndFlow, BothLostAndPart, BrownOut, CoughTrains, Coughs, Drift, Dropped,
    FlowLost, FlowReads, FlowReadsAndPart, Hang, HostSilent, MissedTicks, NewLung, NewTiming, Noise, NoisyAt,
    Offset, OtherHost, OutletLost, OutletOffset, PowerCut, Reads, Reconnected, StuckAt, StuckAtLast,
    SwappedBytes, Weights,
};
use super::injection::POWERLESS_MS;
use super::volume::VolumeLimits;
use plant::bench::{BenchConfig, Failure, PatientConfig};

/// Default pressure limit of the matrix, cmH2O.
pub const LIMIT: f32 = 40.0;
/// Lowest and highest pressure limit of the matrix, cmH2O.
pub const LIMITS: (f32, f32) = (40.0, 70.0);
/// Rise of the true pressure above the limit that is allowed if the valves obey, cmH2O.
const ABOVE_LIMIT: f64 = 20.0;
/// Highest true pressure that the machine's relief valve, which opens at 70 cmH2O, allows at full flow, cmH2O.
pub const RELIEF: f64 = 75.0;
/// PIP of most trials, cmH2O.
pub const PIP: f32 = 25.0;
/// In the middle of the third inspiration, ms.
const MID_INSPIRATION_MS: u32 = 6400;
/// Just before the fourth inspiration, ms.
const BEFORE_MS: u32 = 8900;
/// At the start of the fourth inspiration, with the inspiratory valve opening, ms.
const START_MS: u32 = 9030;
/// In the middle of the second inspiration at 4 breaths a minute, ms.
const SLOW_INSPIRATION_MS: u32 = 15_500;
/// A breath at the usual rate, ms.
pub(super) const BREATH_MS: u32 = 3000;
/// Longest gap without a delivered breath: two breaths; after a reset 3 s, ms.
const GAP_MS: u32 = 2 * BREATH_MS;
const GAP_AFTER_RESET_MS: u32 = 3000;
/// Smallest share of the sound machine's minute volume that must remain, and that under a PID without an integral.
const VOLUME_SHARE: f64 = 0.8;
const SHARE_WITHOUT_INTEGRAL: f64 = 0.5;
/// Share that a stiff and narrow lung takes.
const SHARE_OF_STIFF_LUNG: f64 = 0.3;
/// Duration of a trial after its fault, ms.
const WATCHED_MS: u32 = 21_000;
/// The same for an apnoea, and for a minute volume.
const APNOEA_MS: u32 = 33_000;
const MINUTE_MS: u32 = 75_000;
/// In the middle of an inspiration that ten others precede, ms: what the patient usually gets is known.
const KNOWN_MS: u32 = 10 * BREATH_MS + 400;
/// Duration of a trial whose patient gets less than he did, ms.
const LESS_MS: u32 = 45_000;
/// Longest time constant of a lung that loses volume when it stiffens, s: a slower one fills the better.
const QUICK_LUNG: f64 = 1.0;
/// Time for which the patient of a row is disconnected, ms.
const DISCONNECTED_MS: u32 = 5000;

/// What keeps a fault harmless without an alarm.
#[derive(Clone, Copy, Debug)]
pub struct Safeguard {
    /// Id of the requirement, as the code that fulfils it states it.
    pub requirement: &'static str,
    /// In words.
    pub text: &'static str,
}

const PEEP_FLOW: Safeguard = Safeguard { requirement: "peep-flow", text: "a flow holds PEEP" };
const BREATH_CUT: Safeguard =
    Safeguard { requirement: "breath-cut", text: "the breath is cut at the limit; a cough is no strike" };
const EFFORT_TRIGGERS: Safeguard =
    Safeguard { requirement: "effort-triggers", text: "an effort starts the breath" };
const SETTLED_VOLUMES: Safeguard = Safeguard {
    requirement: "settled-volumes",
    text: "breaths are compared with what the new times leave of the volume",
};
const LEASE: Safeguard =
    Safeguard { requirement: "lease", text: "its requests are refused: it has no lease" };
const SLEW: Safeguard =
    Safeguard { requirement: "residual-slew", text: "slew, limits of the command, cut at the limit, ladder" };
const LADDER: Safeguard =
    Safeguard { requirement: "ladder", text: "limits of the command, cut at the limit, ladder" };

/// A fault and the expected reaction.
#[derive(Clone, Copy, Debug)]
pub struct FaultCase {
    /// Name in tables.
    pub name: &'static str,
    /// The injected fault.
    pub injection: Injection,
    /// The alarms that must occur; if empty, pressure and ventilation are judged.
    pub monitors: &'static [Fault],
    /// What keeps it harmless where no alarm must occur.
    pub safeguard: Option<Safeguard>,
    pub(super) controller: CaseController,
    pub(super) onset_ms: u32,
    /// Settings with this pressure limit, cmH2O.
    pub(super) settings: fn(f32) -> Settings,
    /// Makes the patient breathe; none for a passive one.
    patient: Option<fn(&mut PatientConfig)>,
    /// Whether both valves obey.
    pub(super) obeys: bool,
    /// Whether a high-priority alarm would be false.
    pub(super) quiet: bool,
    /// Alarms of which each would show that a response has failed.
    pub(super) never: &'static [Fault],
    /// Longest time until the first of the monitors fires, ms.
    pub(super) within_ms: u32,
    /// Duration of the trial after the fault, ms.
    pub(super) watched_ms: u32,
    /// Time after the fault from which ventilation is judged, ms.
    pub(super) judged_after_ms: u32,
    /// What ventilation must go on.
    pub ventilation: Required,
    /// Smallest share of the sound machine's minute volume.
    pub least_share: f64,
    /// Alarm limits of the volumes.
    limits: VolumeLimits,
    /// Lowest resistance of a lung with which the fault is possible, cmH2O/(L/s), and its longest time constant, s.
    least_resistance: f64,
    longest_time_constant: f64,
}

/// Ventilation that a row requires after its fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Required {
    /// None: with this fault no command moves gas in and out, or breaths are cut at first.
    Impossible,
    /// A share of the volume, and no gap longer than two breaths.
    GoesOn,
    /// The same with no gap longer than 3 s.
    Resumes,
    /// None may start by itself.
    Stays,
}

/// No alarm limits of the volumes.
const NO_LIMITS: VolumeLimits = VolumeLimits { tidal: (0.0, 0.0), minute: (0.0, 0.0) };

fn usual(pressure_limit: f32) -> Settings {
    Settings { pressure_limit, ..paper_settings(PIP) }
}

/// Settings with a pressure limit that a cough exceeds on every lung.
fn tight(_: f32) -> Settings {
    usual(PIP + 8.0)
}

/// Settings with a limit that a controller can reach on every lung.
fn low(_: f32) -> Settings {
    Settings { pip: 12.0, ..usual(17.0) }
}

/// Settings with a PEEP whose loss shows on every lung.
fn high_peep(limit: f32) -> Settings {
    Settings { peep: 10.0, pip: 30.0, ..usual(limit) }
}

/// Settings at which the valve can fill even a lung that has become softer.
fn gentle(limit: f32) -> Settings {
    Settings { pip: 15.0, ..usual(limit) }
}

/// Settings with four breaths a minute.
fn slow(limit: f32) -> Settings {
    Settings { rate: 4.0, ..usual(limit) }
}

/// Settings whose inspiration fills even a slow lung.
fn long_inspiration(limit: f32) -> Settings {
    Settings { inspiratory_time: 1.5, ..usual(limit) }
}

fn twelve_a_minute(limit: f32) -> Settings {
    Settings { rate: 12.0, ..usual(limit) }
}

fn sixteen_a_minute(limit: f32) -> Settings {
    Settings { rate: 16.0, ..usual(limit) }
}

/// Efforts of this strength, cmH2O, and rate, 1/min.
fn efforts(patient: &mut PatientConfig, effort: f64, rate: f64) {
    (patient.effort_cmh2o, patient.effort_rate_per_min) = (effort, rate);
}

const fn case(name: &'static str, injection: Injection, monitors: &'static [Fault]) -> FaultCase {
    FaultCase {
        name,
        injection,
        monitors,
        safeguard: None,
        controller: Sound,
        onset_ms: MID_INSPIRATION_MS,
        settings: usual,
        patient: None,
        obeys: true,
        quiet: false,
        never: &[],
        within_ms: WATCHED_MS,
        watched_ms: WATCHED_MS,
        judged_after_ms: 0,
        ventilation: Required::GoesOn,
        least_share: VOLUME_SHARE,
        limits: NO_LIMITS,
        least_resistance: 0.0,
        longest_time_constant: f64::INFINITY,
    }
}

/// A pressure sensor that fails: the other one takes over, and the pressure remains controlled.
const fn sensor(name: &'static str, injection: Injection, monitors: &'static [Fault]) -> FaultCase {
    case(name, injection, monitors).never(&[Fault::BackupVentilation])
}

/// A part of the machine that fails.
const fn part(name: &'static str, failure: Failure, monitors: &'static [Fault]) -> FaultCase {
    case(name, Injection::Part(failure), monitors)
}

/// A valve that no longer obeys.
const fn stuck(name: &'static str, failure: Failure, monitors: &'static [Fault]) -> FaultCase {
    FaultCase { obeys: false, ..part(name, failure, monitors) }
}

/// A patient who breathes, at a sound machine.
const fn breathing(name: &'static str, patient: fn(&mut PatientConfig)) -> FaultCase {
    FaultCase { patient: Some(patient), ..case(name, Injection::Controller, &[]) }
}

impl FaultCase {
    /// The settings for a lung at a pressure limit, cmH2O.
    pub(super) fn settings_for(&self, lung: &BenchConfig, limit: f32) -> Settings {
        self.limits.of(lung, (self.settings)(limit))
    }

    /// The settings at a pressure limit, cmH2O, after the fault.
    fn settings_after(&self, limit: f32) -> Settings {
        self.injection.settings((self.settings)(limit))
    }

    /// Highest true airway pressure after the fault at a pressure limit, cmH2O: 20 cmH2O above the limit if the valves obey,
    /// and never more than the relief valve allows.
    pub fn peak_allowed(&self, limit: f32) -> f64 {
        if self.obeys { (f64::from(limit) + ABOVE_LIMIT).min(RELIEF) } else { RELIEF }
    }

    /// Whether the fault is possible with a lung.
    pub(super) fn is_possible(&self, lung: &BenchConfig) -> bool {
        let (resistance, compliance) =
            (lung.lung.first.resistance_cmh2o_per_l_s, lung.lung.first.compliance_ml_per_cmh2o);
        resistance >= self.least_resistance && 1e-3 * resistance * compliance <= self.longest_time_constant
    }

    /// The lung with the patient of this row.
    pub(super) fn bench(&self, lung: &BenchConfig) -> BenchConfig {
        let mut bench = lung.clone();
        if let Some(breathe) = self.patient {
            breathe(&mut bench.patient);
        }
        bench
    }

    /// Longest gap without a delivered breath, ms: that of the row, or two breaths without their inspiration.
    pub fn longest_gap_ms(&self, limit: f32) -> u32 {
        let settings = self.settings_after(limit);
        let pause = 1000.0 * (2.0 * 60.0 / settings.rate - settings.inspiratory_time);
        match self.ventilation {
            Required::GoesOn => GAP_MS.max(pause as u32),
            Required::Resumes => GAP_AFTER_RESET_MS,
            Required::Impossible | Required::Stays => GAP_MS,
        }
    }

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

    /// Judges ventilation from this time on, ms.
    const fn judged_after(self, judged_after_ms: u32) -> Self {
        Self { judged_after_ms, ..self }
    }

    /// Watches for longer, which is how long the monitors may take.
    const fn watched(self, watched_ms: u32) -> Self {
        Self { watched_ms, within_ms: watched_ms, ..self }
    }

    /// Requires that no high-priority alarm comes.
    const fn quietly(self) -> Self {
        Self { quiet: true, ..self }
    }

    /// Requires that none of these alarms comes.
    const fn never(self, never: &'static [Fault]) -> Self {
        Self { never, ..self }
    }

    /// Leaves out lungs with a lower resistance, cmH2O/(L/s): in them no flow of the valve's raises the pressure so far, or
    /// nothing is slow.
    const fn with_resistance(self, least_resistance: f64) -> Self {
        Self { least_resistance, ..self }
    }

    /// Leaves out lungs with a longer time constant, s: they take nearly as much as before.
    const fn with_time_constant(self, longest_time_constant: f64) -> Self {
        Self { longest_time_constant, ..self }
    }

    /// Requires this share of the volume.
    const fn with_share(self, least_share: f64) -> Self {
        Self { least_share, ..self }
    }

    /// Sets lower and upper alarm limits of the tidal volume, as factors on that of the passive lung; 0 for none.
    const fn with_tidal_limits(self, low: f64, high: f64) -> Self {
        Self { limits: VolumeLimits { tidal: (low, high), ..self.limits }, ..self }
    }

    /// The same for the minute volume.
    const fn with_minute_limits(self, low: f64, high: f64) -> Self {
        Self { limits: VolumeLimits { minute: (low, high), ..self.limits }, ..self }
    }

    /// Names what keeps it harmless without an alarm.
    const fn by(self, safeguard: Safeguard) -> Self {
        Self { safeguard: Some(safeguard), ..self }
    }

    const fn resumed(self) -> Self {
        Self { ventilation: Required::Resumes, ..self }
    }

    /// Requires that no breath is delivered.
    const fn stays(self) -> Self {
        Self { ventilation: Required::Stays, ..self }
    }

    const fn with(self, settings: fn(f32) -> Settings) -> Self {
        Self { settings, ..self }
    }

    const fn run_by(self, controller: CaseController) -> Self {
        Self { controller, ..self }
    }
}

/// Faults of the sensor.
const SENSOR: [FaultCase; 23] = [
    sensor("reading stuck at its last value", StuckAtLast, &[Fault::ReadingFrozen]),
    sensor("reading stuck at PEEP", StuckAt(5.0), &[Fault::ReadingFrozen]).at(BEFORE_MS).within_a_breath(),
    sensor("reading stuck at 0", StuckAt(0.0), &[Fault::ReadingFrozen]).at(BEFORE_MS).within_a_breath(),
    sensor("reading stuck at PEEP with normal noise", NoisyAt(5.0), &[Fault::SensorsDisagree])
        .at(BEFORE_MS)
        .within_a_breath(),
    sensor("reading is not a number", Reads(f32::NAN), &[Fault::ReadingNotANumber]),
    sensor("reading is infinite", Reads(f32::INFINITY), &[Fault::ReadingOutOfRange]),
    sensor("reading drifts up by 1 cmH2O/s", Drift(1.0), &[Fault::SensorsDisagree]),
    sensor("reading drifts down by 1 cmH2O/s", Drift(-1.0), &[Fault::SensorsDisagree]),
    sensor("reading is 5 cmH2O too high", Offset(5.0), &[Fault::SensorsDisagree]),
    sensor("reading is 5 cmH2O too low", Offset(-5.0), &[Fault::SensorsDisagree]),
    sensor("outlet reading is 5 cmH2O too high", OutletOffset(5.0), &[Fault::SensorsDisagree]),
    sensor("outlet reading is 5 cmH2O too low", OutletOffset(-5.0), &[Fault::SensorsDisagree]),
    case("sensor noise ten times higher", Noise(1.0), &[Fault::ReadingNoisy]),
    sensor("one third of the readings lost", Dropped(0.33), &[Fault::ReadingNotANumber]),
    sensor("bytes swapped in one third of the readings", SwappedBytes(0.33), &[Fault::ReadingJumps]),
    sensor("outlet sensor lost", OutletLost, &[Fault::OutletSensorLost]),
    case("both pressure sensors lost", BothLost, &[Fault::BackupVentilation]),
    case("both pressure sensors lost before a breath", BothLost, &[Fault::BackupVentilation]).at(BEFORE_MS),
    // The commands of good breaths would deliver three fifths of their volume.
    case(
        "both pressure sensors lost, supply falls to 60 %",
        BothLostAndPart(Failure::SupplyFalls(0.6)),
        &[Fault::BackupVentilation],
    ),
    case(
        "both pressure sensors lost, flow sensor stuck at 0",
        BothLostAndFlow(0.0),
        &[Fault::BackupVentilation],
    ),
    case(
        "both pressure sensors and the flow sensor lost",
        BothLostAndFlow(f32::NAN),
        &[Fault::BackupVentilation, Fault::FlowSensorLost],
    ),
    // Nothing is known about the volumes then, so no alarm may claim that they are low.
    case("flow sensor lost", FlowLost, &[Fault::FlowSensorLost])
        .with_tidal_limits(0.7, 0.0)
        .with_minute_limits(0.7, 0.0)
        .watched(MINUTE_MS)
        .never(&[Fault::TidalVolumeLow, Fault::MinuteVolumeLow, Fault::Apnoea]),
    case("flow sensor stuck at 0.1 L/s", FlowReads(0.1), &[Fault::FlowSensorLost]).quietly(),
];

/// Faults of machine and breathing circuit.
const MACHINE: [FaultCase; 19] = [
    part("tube occluded", Failure::TubeOccluded, &[Fault::Occlusion]).at(BEFORE_MS).not_ventilated(),
    part("tube occluded for half a minute", Failure::TubeOccluded, &[Fault::Apnoea])
        .at(BEFORE_MS)
        .watched(APNOEA_MS)
        .not_ventilated(),
    // What stands still must not pass for breaths.
    case(
        "tube occluded, flow sensor stuck at 0.1 L/s",
        FlowReadsAndPart(0.1, Failure::TubeOccluded),
        &[Fault::Occlusion, Fault::FlowSensorLost],
    )
    .at(BEFORE_MS)
    .not_ventilated(),
    part(
        "tube narrowed, eight times the resistance",
        Failure::TubeNarrowed(8.0),
        &[Fault::VentilationFalls, Fault::VentilationLost],
    )
    .with_resistance(20.0)
    .at(KNOWN_MS)
    .watched(LESS_MS)
    .not_ventilated(),
    stuck("expiratory filter clogged", Failure::FilterClogged, &[Fault::BaselineHigh]).not_ventilated(),
    part("patient disconnected", Failure::Disconnected, &[Fault::Disconnection]).not_ventilated(),
    // Full ventilation within one breath of the reconnection.
    case("patient disconnected for 5 s", Reconnected(DISCONNECTED_MS), &[Fault::Disconnection])
        .judged_after(DISCONNECTED_MS + BREATH_MS),
    part("leak of 0.2 L/s", Failure::Leak(0.2), &[]).by(PEEP_FLOW).at(BEFORE_MS).never(&[Fault::BaselineLow]),
    part("leak of 0.5 L/s", Failure::Leak(0.5), &[]).by(PEEP_FLOW).at(BEFORE_MS).never(&[Fault::BaselineLow]),
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
];

/// Patients who breathe or cough, lungs and settings that change: no fault of the machine's.
const PATIENT: [FaultCase; 17] = [
    case("cough in every breath", Coughs(25.0), &[]).by(BREATH_CUT).with(tight),
    case("trains of six coughs", CoughTrains(40.0), &[]).by(BREATH_CUT),
    breathing("efforts of 3 cmH2O, 21 a minute against 20", |patient| efforts(patient, 3.0, 21.0))
        .by(EFFORT_TRIGGERS)
        .quietly(),
    breathing("efforts of 4 cmH2O, 12.5 a minute against 12", |patient| efforts(patient, 4.0, 12.5))
        .by(EFFORT_TRIGGERS)
        .with(twelve_a_minute)
        .quietly(),
    breathing("efforts of 4 cmH2O, 16.5 a minute against 16", |patient| efforts(patient, 4.0, 16.5))
        .by(EFFORT_TRIGGERS)
        .with(sixteen_a_minute)
        .quietly(),
    breathing("efforts of 4 cmH2O, 20.5 a minute against 20", |patient| efforts(patient, 4.0, 20.5))
        .by(EFFORT_TRIGGERS)
        .quietly(),
    breathing("efforts of 15 cmH2O", |patient| efforts(patient, 15.0, 14.0)).by(EFFORT_TRIGGERS).quietly(),
    breathing("double efforts of 8 cmH2O", |patient| {
        efforts(patient, 8.0, 17.0);
        (patient.effort_variability_percent, patient.double_efforts_percent) = (20.0, 50.0);
    })
    .by(EFFORT_TRIGGERS)
    .quietly(),
    case("inspiration shortened from 1.5 to 0.4 s", NewTiming(20.0, 0.4), &[])
        .by(SETTLED_VOLUMES)
        .with(long_inspiration)
        .with_resistance(50.0)
        .quietly(),
    case("inspiration lengthened from 1 to 1.5 s", NewTiming(20.0, 1.5), &[])
        .by(SETTLED_VOLUMES)
        .with_resistance(50.0)
        .quietly(),
    case("rate raised from 12 to 30 a minute", NewTiming(30.0, 0.7), &[])
        .by(SETTLED_VOLUMES)
        .with(twelve_a_minute)
        .with_resistance(50.0)
        .quietly(),
    case("lung stiffens and its airways narrow", NewLung(2.0, 0.4), &[Fault::TidalVolumeLow])
        .with_tidal_limits(0.7, 0.0)
        .with_share(SHARE_OF_STIFF_LUNG),
    // Without an alarm limit.
    case("airways narrow to five times their resistance", NewLung(5.0, 1.0), &[Fault::VentilationFalls])
        .with_resistance(20.0)
        .at(KNOWN_MS)
        .watched(LESS_MS)
        .not_ventilated(),
    case("lung loses seven tenths of its compliance", NewLung(1.0, 0.3), &[Fault::VentilationFalls])
        .with_time_constant(QUICK_LUNG)
        .at(KNOWN_MS)
        .watched(LESS_MS)
        .not_ventilated(),
    case("lung becomes softer", NewLung(0.5, 2.0), &[Fault::TidalVolumeHigh])
        .with(gentle)
        .with_tidal_limits(0.0, 1.4),
    case("rate lowered from 20 to 8 a minute", NewTiming(8.0, 1.0), &[Fault::MinuteVolumeLow])
        .with_minute_limits(0.7, 0.0)
        .watched(MINUTE_MS),
    case(
        "rate raised from 12 to 30 a minute, with a limit",
        NewTiming(30.0, 1.0),
        &[Fault::MinuteVolumeHigh],
    )
    .with(twelve_a_minute)
    .with_minute_limits(0.0, 1.3)
    .watched(MINUTE_MS),
];

/// Faults of chip and controller.
const CONTROL: [FaultCase; 15] = [
    case("10 of every 100 control ticks missed", MissedTicks(10), &[Fault::MissedTicks]),
    case("control task hangs", Hang, &[Fault::Restarted]).resumed(),
    case("control task hangs at the start of a breath", Hang, &[Fault::Restarted]).at(START_MS).resumed(),
    case("power supply dips during an inspiration", BrownOut, &[Fault::Restarted]).resumed(),
    case("power cut of 10 s", PowerCut(POWERLESS_MS / 1000), &[Fault::Restarted])
        .judged_after(POWERLESS_MS)
        .resumed(),
    case("power cut of 16 minutes", PowerCut(16 * 60), &[Fault::Restarted])
        .judged_after(POWERLESS_MS)
        .stays(),
    case("host goes silent during exploration", HostSilent, &[Fault::HostSilent]),
    case("a second host sends other settings and gains", OtherHost, &[]).by(LEASE),
    case("one bit of the stored weights flipped", Weights(Damage::FlippedBit), &[Fault::WeightsRefused])
        .run_by(Greedy),
    case("power lost while weights are stored", Weights(Damage::TornStore), &[Fault::WeightsRefused])
        .run_by(Greedy),
    case("network that always requests 100 % more", Injection::Controller, &[]).by(SLEW).run_by(Greedy),
    case("network that drives each breath to the limit", Injection::Controller, &[Fault::LearnedDistrusted])
        .with(low)
        .run_by(Greedy)
        .at(0)
        // The PID in its place after two breaths; it has no integral.
        .judged_after(2 * BREATH_MS)
        .with_share(SHARE_WITHOUT_INTEGRAL)
        .never(&[Fault::CommandCapped]),
    case("PID that drives each breath to the limit", Injection::Controller, &[Fault::CommandCapped])
        .with(low)
        .run_by(Ringing)
        .with_resistance(20.0)
        .at(0)
        // The capped PID after three.
        .judged_after(3 * BREATH_MS),
    case("network that alternates between fully open and closed", Injection::Controller, &[])
        .by(SLEW)
        .run_by(Alternating),
    case("oscillating PID", Injection::Controller, &[]).by(LADDER).run_by(Ringing),
];

/// What the rows can do to a patient.
pub const HAZARDS: [(&str, &[FaultCase]); 4] = [
    ("pressure controlled by a wrong reading, or by none", &SENSOR),
    ("gas that does not get to the patient, or not out again", &MACHINE),
    ("ventilation that does not suit a living patient", &PATIENT),
    ("commands that are wrong, late or missing", &CONTROL),
];

/// All rows.
pub fn cases() -> impl Iterator<Item = &'static FaultCase> {
    HAZARDS.iter().flat_map(|(_, cases)| *cases)
}
