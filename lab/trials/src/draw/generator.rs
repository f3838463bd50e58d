//! Draws cases: machine, patient, prescription, controller, and one to three faults of any kind, strength, time and rhythm.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use shared::breath::paper_settings;
use shared::control::pid::PidGains;
use shared::device::KNOWN_GOOD;
use shared::settings::Settings;

use super::case::{Case, Law, Rhythm, Stalls};
use crate::faults::hostile::SOUND;
use crate::faults::volume::VolumeLimits;
use plant::bench::family::Family;
use plant::bench::{BenchConfig, Distortion, Failure, FaultConfig, Faulty, Repeats, Signal, Strain};
use plant::prescriptions::Prescriptions;
use ventilator::SourceError;

/// Share of the cases on a newborn's machine.
const NEWBORNS: f64 = 0.15;
/// Share of the patients who breathe.
const BREATHING: f64 = 0.4;
/// Shares of the cases with two and with three faults.
const TWO: f64 = 0.25;
const THREE: f64 = 0.1;
/// Share of the faults that end before the case does, and of those that come and go.
const PASSING: f64 = 0.25;
const RECURRING: f64 = 0.25;
/// Breaths, and time, before the first fault, s.
const BEFORE: (f64, f64) = (5.0, 12.0);
/// Breaths, and time, from the last beginning of a fault on, s.
const AFTER: (f64, f64) = (8.0, 45.0);
/// Share of the alarm limits of the volumes that are set, and what they are, as factors on what the passive lung gets.
const LIMITED: f64 = 0.3;
const LOWEST: (f64, f64) = (0.5, 0.8);
const HIGHEST: (f64, f64) = (1.3, 2.5);
/// Longest time between the beginnings of two faults, s.
const APART_S: f64 = 12.0;

/// Draws cases from a seed.
#[derive(Clone, Debug)]
pub struct Generator {
    seed: u64,
    families: [(Family, Prescriptions, &'static str); 2],
}

impl Generator {
    /// A generator with the shipped families and controllers.
    ///
    /// # Errors
    /// A family that cannot be read.
    pub fn new(seed: u64) -> Result<Self, SourceError> {
        let shipped = |name: &'static str| {
            let family = Family::find(name).map_err(|_| SourceError::Stopped)?;
            let bedside = family.prescriptions("bedside").map_err(|_| SourceError::Stopped)?;
            Ok::<_, SourceError>((family, bedside, name))
        };
        Ok(Self { seed, families: [shipped("adult")?, shipped("neonate")?] })
    }

    /// The case with this number.
    pub fn draw(&self, number: u64) -> Case {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(number);
        let newborn = chance(&mut rng, NEWBORNS);
        let (family, bedside, learned) = &self.families[usize::from(newborn)];
        let place = (number % u64::from(u32::MAX)) as u32;
        let settings = match rng.random_range(0..4) {
            0 if !newborn => paper_settings(one_of([10.0, 15.0, 20.0, 25.0, 30.0, 35.0], &mut rng)),
            _ => bedside.draw(self.seed, place),
        };
        let mut bench = family.draw(self.seed, place);
        if chance(&mut rng, BREATHING) {
            breathe(&mut rng, &mut bench, &settings, newborn);
        }
        let gains = |gains: PidGains| Law::Pid([gains.p, gains.i, gains.d]);
        let controller = match rng.random_range(0..4) {
            0 => gains(KNOWN_GOOD),
            1 if !newborn => gains(SOUND),
            1 => gains(family.pid.unwrap_or(KNOWN_GOOD)),
            _ => Law::Learned((*learned).to_owned()),
        };
        let breath_s = 60.0 / f64::from(settings.rate);
        let first_s = (BEFORE.0 * breath_s).max(BEFORE.1) + breath_s * rng.random_range(0.0..1.0);
        let mut case = Case {
            seed: u64::from(rng.random::<u32>()),
            seconds: 1.0,
            controller,
            stalls: None,
            settings,
            host: None,
            bench,
        };
        let count = match rng.random_range(0.0..1.0) {
            share if share < THREE => 3,
            share if share < THREE + TWO => 2,
            _ => 1,
        };
        let mut last_s = first_s;
        for n in 0..count {
            let from_s = if n == 0 { first_s } else { first_s + rng.random_range(0.0..APART_S) };
            last_s = last_s.max(from_s);
            add(&mut rng, &mut case, rounded(from_s), breath_s);
        }
        case.seconds = rounded(last_s + (AFTER.0 * breath_s).max(AFTER.1));
        self.limit(number, &mut case);
        case
    }

    /// Sets alarm limits of the volumes, unless the host does. They come from a random stream of their own: all else is as it was
    /// before there were any. No minute volume has a lower limit, because missed ticks hide gas from the sum.
    fn limit(&self, number: u64, case: &mut Case) {
        let mut rng = ChaCha8Rng::seed_from_u64(!self.seed);
        rng.set_stream(number);
        let mut factor =
            |(least, most)| if chance(&mut rng, LIMITED) { rng.random_range(least..most) } else { 0.0 };
        let tidal = (factor(LOWEST), factor(HIGHEST));
        let limits = VolumeLimits { tidal, minute: (0.0, factor(HIGHEST)) };
        if case.host.is_none_or(|host| host.settings.tidal_volume_high <= 0.0) {
            case.settings = limits.of(&case.bench, case.settings);
            case.host = case.host.map(|host| {
                let settings = limits.of(&case.bench, host.settings);
                Rhythm { settings, ..host }
            });
        }
    }
}

/// Adds a fault that begins at a time, s.
fn add(rng: &mut ChaCha8Rng, case: &mut Case, from_s: f64, breath_s: f64) {
    match rng.random_range(0..20) {
        0 if case.stalls.is_none() => case.stalls = Some(stalls(rng, from_s, breath_s)),
        1 if case.host.is_none() => {
            let every_s = rounded(breath_s * log(rng, 0.4, 4.0));
            case.host = Some(Rhythm { from_s, every_s, settings: altered(rng, case.settings) });
        }
        _ => {
            let what = faulty(rng, &case.settings);
            let passing = chance(rng, PASSING);
            let to_s = passing.then(|| rounded(from_s + log(rng, 0.1, 40.0)));
            let repeats = chance(rng, RECURRING).then(|| {
                let every_s = one_of([breath_s, 3.0 * breath_s, rounded(log(rng, 0.05, 20.0))], rng);
                Repeats { for_s: rounded(every_s * rng.random_range(0.05..0.9)).max(1e-3), every_s }
            });
            let repeats = repeats.filter(|repeats| repeats.for_s < repeats.every_s);
            case.bench.faults.push(FaultConfig { from_s, to_s, repeats, what });
        }
    }
}

fn stalls(rng: &mut ChaCha8Rng, from_s: f64, breath_s: f64) -> Stalls {
    let ticks = log(rng, 1.0, 90.0) as u32;
    let every_ms = one_of([1e3 * breath_s, log(rng, 20.0, 5000.0)], rng) as u32;
    Stalls { from_s, ticks, every_ms: every_ms.max(2 * ticks) }
}

/// The settings with one or two fields changed a little or a lot.
fn altered(rng: &mut ChaCha8Rng, settings: Settings) -> Settings {
    let change = |rng: &mut ChaCha8Rng, settings: Settings| {
        let factor = 1.0 + one_of([0.005, 0.05, 0.3], rng) * one_of([-1.0_f32, 1.0], rng);
        match rng.random_range(0..6) {
            0 => Settings { rate: settings.rate * factor, ..settings },
            1 => Settings { pip: settings.peep + (settings.pip - settings.peep) * factor, ..settings },
            2 => Settings { peep: settings.peep * factor, ..settings },
            3 => Settings { inspiratory_time: settings.inspiratory_time * factor, ..settings },
            4 => Settings { tidal_volume_high: 2000.0 * factor, ..settings },
            _ => Settings { rise_time: 0.1 * factor, ..settings },
        }
    };
    let tried = (0..20).map(|_| change(rng, settings)).find(|settings| settings.validate().is_ok());
    tried.unwrap_or(settings)
}

/// What fails.
fn faulty(rng: &mut ChaCha8Rng, settings: &Settings) -> Faulty {
    match rng.random_range(0..20) {
        0..=9 => sensor(rng, settings),
        10..=15 => Faulty::Part(part(rng, settings)),
        16 => Faulty::SupplySwings {
            least: rounded(rng.random_range(0.0..0.9)),
            hz: rounded(log(rng, 0.2, 15.0)),
        },
        17 => Faulty::LeakInPhase { inspiration: rng.random(), l_per_s: rounded(log(rng, 0.1, 3.0)) },
        18 => Faulty::Lung {
            resistance: rounded(log(rng, 0.3, 10.0)),
            compliance: rounded(log(rng, 0.25, 3.0)),
        },
        _ => {
            let cmh2o = if chance(rng, 0.8) { log(rng, 15.0, 120.0) } else { -log(rng, 5.0, 40.0) };
            Faulty::Strain(Strain { cmh2o: rounded(cmh2o), duration_s: rounded(log(rng, 0.2, 5.0)) })
        }
    }
}

fn sensor(rng: &mut ChaCha8Rng, settings: &Settings) -> Faulty {
    let signals = [
        Signal::Airway,
        Signal::Airway,
        Signal::Outlet,
        Signal::Outlet,
        Signal::Flow,
        Signal::Flow,
        Signal::Pressures,
    ];
    let mut signal = one_of(signals, rng);
    if chance(rng, 0.05) {
        signal = Signal::Converter;
    }
    let flow = signal == Signal::Flow;
    // Sizes in cmH2O, and for a flow in twentieths of a litre per second.
    let unit = if flow { 0.05 } else { 1.0 };
    let sign = one_of([-1.0, 1.0], rng);
    let distortion = match rng.random_range(0..14) {
        0 => Distortion::Offset(sign * unit * log(rng, 0.3, 30.0)),
        // Some flow sensors are mounted the wrong way round.
        1 if flow && rng.random() => Distortion::Gain(-1.0),
        1 | 2 => Distortion::Gain(log(rng, 0.4, 2.2)),
        3 | 4 => Distortion::LagMs(log(rng, 10.0, 600.0)),
        5 => Distortion::DeadTimeMs(log(rng, 5.0, 300.0)),
        6 => Distortion::DriftPerS(sign * unit * log(rng, 0.02, 5.0)),
        7 => Distortion::Noise(unit * log(rng, 0.1, 5.0)),
        8 => Distortion::Hum { amplitude: unit * log(rng, 0.2, 8.0), hz: log(rng, 1.0, 400.0) },
        9 => Distortion::Quantum(unit * log(rng, 0.1, 3.0)),
        10 => {
            let high = if flow { 0.02 } else { f64::from(settings.pip) };
            Distortion::Saturates { low: -high, high: high * rng.random_range(0.3..1.0) }
        }
        11 => Distortion::Freezes,
        12 => {
            let at = if flow {
                log(rng, 0.005, 0.5)
            } else {
                rng.random_range(0.0..1.2) * f64::from(settings.pip)
            };
            let noise = one_of([0.0, 0.1 * unit], rng);
            Distortion::Stands { at: one_of([0.0, at, at], rng), noise }
        }
        _ => one_of(
            [
                Distortion::Missing(log(rng, 0.002, 1.0)),
                Distortion::Missing(1.0),
                Distortion::Spikes { share: log(rng, 0.001, 0.5), height: sign * unit * log(rng, 3.0, 80.0) },
            ],
            rng,
        ),
    };
    Faulty::Sensor { signal, distortion: tidy(distortion) }
}

fn part(rng: &mut ChaCha8Rng, settings: &Settings) -> Failure {
    match rng.random_range(0..14) {
        0 => Failure::TubeOccluded,
        1..=3 => Failure::TubeNarrowed(rounded(log(rng, 1.5, 50.0))),
        4 => Failure::FilterClogged,
        5 => Failure::FilterNarrowed(rounded(log(rng, 0.03, 0.8))),
        6 => Failure::Disconnected,
        7 | 8 => Failure::Leak(rounded(log(rng, 0.1, 6.0))),
        9 => Failure::InspiratoryValveStuck(rounded(rng.random_range(0.0..100.0))),
        10 => Failure::BothValvesStuck(rounded(rng.random_range(20.0..100.0))),
        11 => one_of([Failure::ExpiratoryValveClosed, Failure::SupplyLost], rng),
        12 => Failure::PeepValveStuck(rounded(rng.random_range(0.0..f64::from(settings.pip)))),
        _ => one_of(
            [
                Failure::SupplyFalls(rounded(rng.random_range(0.1..0.9))),
                Failure::ValveLoose(rounded(rng.random_range(6.0..25.0))),
            ],
            rng,
        ),
    }
}

/// Makes the patient breathe, regularly or not, and at times cough.
fn breathe(rng: &mut ChaCha8Rng, bench: &mut BenchConfig, settings: &Settings, newborn: bool) {
    let rate =
        (f64::from(settings.rate) * rng.random_range(0.6..1.6)).clamp(5.0, if newborn { 70.0 } else { 40.0 });
    let patient = &mut bench.patient;
    patient.effort_cmh2o = rounded(log(rng, 2.0, 15.0));
    patient.effort_rate_per_min = rounded(rate);
    patient.effort_duration_s = rounded(rng.random_range(0.25..0.5) * 60.0 / rate).min(1.2);
    patient.effort_variability_percent = rounded(rng.random_range(0.0..30.0));
    patient.double_efforts_percent = one_of([0.0, 0.0, 5.0], rng);
    if chance(rng, 0.2) {
        patient.cough_cmh2o = rounded(rng.random_range(10.0..60.0));
        patient.coughs_per_hour = rounded(log(rng, 10.0, 120.0));
    }
}

/// The distortion with numbers that are easy to read.
fn tidy(distortion: Distortion) -> Distortion {
    use Distortion as D;
    match distortion {
        D::Offset(value) => D::Offset(rounded(value)),
        D::Gain(value) => D::Gain(rounded(value)),
        D::LagMs(value) => D::LagMs(rounded(value)),
        D::DeadTimeMs(value) => D::DeadTimeMs(rounded(value)),
        D::DriftPerS(value) => D::DriftPerS(rounded(value)),
        D::Noise(value) => D::Noise(rounded(value)),
        D::Hum { amplitude, hz } => D::Hum { amplitude: rounded(amplitude), hz: rounded(hz) },
        D::Quantum(value) => D::Quantum(rounded(value)),
        D::Saturates { low, high } => D::Saturates { low: rounded(low), high: rounded(high) },
        D::Freezes => D::Freezes,
        D::Stands { at, noise } => D::Stands { at: rounded(at), noise },
        D::Spikes { share, height } => D::Spikes { share: rounded(share), height: rounded(height) },
        D::Missing(share) => D::Missing(rounded(share)),
    }
}

/// Three significant digits.
pub(super) fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let scale = 10.0_f64.powf(2.0 - value.abs().log10().floor());
    (value * scale).round() / scale
}

fn chance(rng: &mut ChaCha8Rng, share: f64) -> bool {
    rng.random_range(0.0..1.0) < share
}

fn one_of<T: Copy, const N: usize>(items: [T; N], rng: &mut ChaCha8Rng) -> T {
    items[rng.random_range(0..N)]
}

fn log(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low * (high / low).powf(rng.random_range(0.0..1.0))
}
