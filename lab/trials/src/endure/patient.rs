//! The patients: lung, breathing, machine and settings, each drawn from the seed and the patient's number alone.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::StandardNormal;
use shared::settings::{LIMIT_MARGIN, Settings};

use crate::faults::volume::{VolumeLimits, passive_volume_ml};
use plant::bench::{BenchConfig, Failure, LeakChange};

/// Resistance, cmH2O/(L/s), and compliance, mL/cmH2O.
const LUNGS: [(f64, f64); 2] = [(5.0, 50.0), (10.0, 60.0)];
/// Standard deviation of the pressure sensors' noise, cmH2O.
const NOISE: (f64, f64) = (0.03, 0.2);
/// Quantum of the pressure sensors, cmH2O; never above the noise, so that no sound sensor is silent.
const QUANTUM: (f64, f64) = (0.01, 0.1);
/// Spread of the outlet sensor's offset, cmH2O, and of the flow sensor's gain, percent (sd).
const OUTLET_OFFSET: f64 = 0.3;
const FLOW_GAIN: f64 = 3.0;
/// Drift of a pressure sensor of one machine in ten, cmH2O/h.
const DRIFT: f64 = 1.0;
/// A tight circuit's leak, and the largest one, L/s at 30 cmH2O.
const TIGHT: f64 = 0.005;
const LEAK: f64 = 0.5;
/// Time between two changes of the leak, s.
const LEAK_LASTS: (f64, f64) = (300.0, 1800.0);
/// Breaths between two changes of the settings.
const SETTINGS_LAST: (f64, f64) = (200.0, 600.0);
/// Smallest and largest rise from PEEP to PIP, cmH2O.
const RISE: (f32, f32) = (5.0, 30.0);
/// Highest PIP that a device accepts, cmH2O.
const HIGHEST_PIP: f32 = 50.0;
/// Alarm limits of the volumes, as factors on what the passive lung gets; and the highest ones that a device accepts, mL, L/min.
const LIMITS: VolumeLimits = VolumeLimits { tidal: (0.5, 2.5), minute: (0.5, 2.5) };
const HIGHEST_LIMITS: (f32, f32) = (3000.0, 60.0);

/// A patient at a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Patient {
    /// Number, from 0.
    pub number: u64,
    /// Lung, breathing and machine.
    pub bench: BenchConfig,
    /// Settings at the start.
    pub settings: Settings,
    /// Settings that replace them later, in the order of their times.
    pub changes: Vec<SettingsChange>,
    /// Seed of all noise and irregularity.
    pub seed: u64,
    /// A part of the machine that fails, and when, ms. No drawn patient has one.
    pub failure: Option<(u32, Failure)>,
}

/// Settings that the operator enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettingsChange {
    /// Time, s.
    pub at_s: f64,
    /// The new settings.
    pub settings: Settings,
}

impl Patient {
    /// Draws the patient of this number, for a stay of some hours. The beginning of a longer stay is the shorter one.
    pub fn draw(seed: u64, number: u64, hours: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(number);
        let [resistance, compliance] = LUNGS.map(|range| log_uniform(&mut rng, range));
        let mut bench = BenchConfig::paper(resistance, compliance);
        bench.name = format!("patient {number}");
        let settings = prescription(&mut rng);
        machine(&mut rng, &mut bench);
        breathing(&mut rng, &mut bench, f64::from(settings.rate));
        let noise = rng.random();
        // As many draws as the stay is long: from generators of their own.
        let [mut of_leaks, mut of_changes] = [(); 2].map(|()| ChaCha8Rng::seed_from_u64(rng.random()));
        leaks(&mut of_leaks, &mut bench, hours);
        let mut changes = changes(&mut of_changes, settings, hours);
        for change in &mut changes {
            change.settings = limited(&bench, change.settings);
        }
        let settings = limited(&bench, settings);
        Self { number, bench, settings, changes, seed: noise, failure: None }
    }

    /// All settings with their durations in a stay of some seconds.
    pub fn spans(&self, seconds: f64) -> impl Iterator<Item = (Settings, f64)> {
        let starts = std::iter::once((0.0, self.settings))
            .chain(self.changes.iter().map(|change| (change.at_s, change.settings)));
        let ends = self.changes.iter().map(|change| change.at_s).chain(std::iter::once(f64::INFINITY));
        starts.zip(ends).map(move |((from, settings), to)| (settings, (to.min(seconds) - from).max(0.0)))
    }

    /// The same lung and machine with a passive patient, a tight circuit, and no secretions.
    pub fn passive_bench(&self) -> BenchConfig {
        let mut bench = self.bench.clone();
        bench.circuit.leak_l_per_s_at_30_cmh2o = TIGHT;
        bench.circuit.leak_changes = Vec::new();
        bench.patient = BenchConfig::default().patient;
        bench
    }

    /// Volume of a breath of the passive lung at these settings once breath follows breath evenly, mL.
    pub fn passive_volume_ml(&self, settings: &Settings) -> f64 {
        passive_volume_ml(&self.bench, settings)
    }
}

fn uniform(rng: &mut ChaCha8Rng, (low, high): (f64, f64)) -> f64 {
    rng.random_range(low..=high)
}

fn log_uniform(rng: &mut ChaCha8Rng, (low, high): (f64, f64)) -> f64 {
    uniform(rng, (low.ln(), high.ln())).exp()
}

fn normal(rng: &mut ChaCha8Rng, sd: f64) -> f64 {
    sd * rng.sample::<f64, _>(StandardNormal)
}

/// Valid settings.
fn prescription(rng: &mut ChaCha8Rng) -> Settings {
    let pressure_limit = rng.random_range(40.0_f32..=70.0);
    let peep = rng.random_range(0.0_f32..=15.0);
    let highest = HIGHEST_PIP.min(pressure_limit - LIMIT_MARGIN).min(peep + RISE.1);
    let rate = rng.random_range(8.0_f32..=40.0);
    let cycle = 60.0 / rate;
    let fall_time = (cycle / 6.0).min(0.5);
    let inspiratory_time = rng.random_range(0.2 * cycle..=0.5 * cycle).clamp(0.3, 3.0);
    let rise_time = if rng.random() { 0.0 } else { rng.random_range(0.0_f32..=0.3).min(inspiratory_time) };
    Settings {
        pip: rng.random_range(peep + RISE.0..=highest),
        peep,
        rate,
        inspiratory_time,
        rise_time,
        fall_time,
        pressure_limit,
        ..Settings::default()
    }
}

/// The settings with the alarm limits that an operator would set for this lung.
fn limited(bench: &BenchConfig, settings: Settings) -> Settings {
    let limited = LIMITS.of(bench, settings);
    Settings {
        tidal_volume_high: limited.tidal_volume_high.min(HIGHEST_LIMITS.0),
        minute_volume_high: limited.minute_volume_high.min(HIGHEST_LIMITS.1),
        ..limited
    }
}

/// Settings that follow one another; each change concerns some of them.
fn changes(rng: &mut ChaCha8Rng, first: Settings, hours: f64) -> Vec<SettingsChange> {
    let (mut changes, mut settings, mut at_s) = (Vec::new(), first, 0.0);
    loop {
        at_s += uniform(rng, SETTINGS_LAST) * 60.0 / f64::from(settings.rate);
        if at_s >= hours * 3600.0 {
            return changes;
        }
        settings = changed(rng, settings);
        changes.push(SettingsChange { at_s, settings });
    }
}

fn changed(rng: &mut ChaCha8Rng, before: Settings) -> Settings {
    let other = prescription(rng);
    let Settings { pip, peep, pressure_limit, .. } = other;
    match rng.random_range(0..3) {
        0 => Settings { pip, peep, pressure_limit, ..before },
        1 => Settings { pip: before.pip, peep: before.peep, pressure_limit: before.pressure_limit, ..other },
        _ => other,
    }
}

/// The machine's deviations and its sensors.
fn machine(rng: &mut ChaCha8Rng, bench: &mut BenchConfig) {
    bench.unit.number = rng.random_range(1..100_000);
    let [airway, outlet] = [(); 2].map(|()| {
        let noise = uniform(rng, NOISE);
        (noise, uniform(rng, (QUANTUM.0, QUANTUM.1.min(noise))))
    });
    (bench.sensor.noise_sd_cmh2o, bench.sensor.quantum_cmh2o) = airway;
    (bench.outlet_sensor.noise_sd_cmh2o, bench.outlet_sensor.quantum_cmh2o) = outlet;
    bench.outlet_sensor.offset_cmh2o = normal(rng, OUTLET_OFFSET);
    bench.flow_sensor.gain_error_percent = normal(rng, FLOW_GAIN);
    let drift = uniform(rng, (-DRIFT, DRIFT));
    match rng.random_range(0..20) {
        0 => bench.unit.sensor_drift_cmh2o_per_hour = drift,
        1 => bench.outlet_sensor.drift_cmh2o_per_hour = drift,
        _ => {}
    }
}

/// Efforts of half of the patients, coughs, secretions.
fn breathing(rng: &mut ChaCha8Rng, bench: &mut BenchConfig, rate: f64) {
    let patient = &mut bench.patient;
    // All are always drawn, so that one patient's draws do not shift the next ones.
    let breathes = rng.random_bool(0.5);
    let effort = uniform(rng, (0.0, 20.0));
    let effort_rate = if rng.random_range(0..3) == 0 {
        rate * uniform(rng, (0.95, 1.05))
    } else {
        uniform(rng, (8.0, 35.0))
    };
    patient.effort_rate_per_min = effort_rate;
    patient.effort_duration_s = uniform(rng, (0.5, 1.2)).min(0.6 * 60.0 / effort_rate);
    patient.effort_variability_percent = uniform(rng, (0.0, 30.0));
    patient.double_efforts_percent = uniform(rng, (0.0, 10.0));
    patient.effort_cmh2o = if breathes { effort } else { 0.0 };
    patient.cough_cmh2o = uniform(rng, (20.0, 60.0));
    patient.coughs_per_hour = if rng.random() { uniform(rng, (0.0, 20.0)) } else { 0.0 };
    // Without random coughs, `cough_cmh2o` would be a single one.
    patient.cough_at_s = 1e6;
    let growth = uniform(rng, (0.0, 20.0));
    patient.resistance_growth_percent_per_hour = if rng.random_range(0..3) == 0 { growth } else { 0.0 };
}

/// The leak and its changes.
fn leaks(rng: &mut ChaCha8Rng, bench: &mut BenchConfig, hours: f64) {
    let circuit = &mut bench.circuit;
    circuit.leak_l_per_s_at_30_cmh2o = leak(rng);
    let mut at_s = uniform(rng, LEAK_LASTS);
    while at_s < hours * 3600.0 {
        circuit.leak_changes.push(LeakChange { at_s, leak_l_per_s_at_30_cmh2o: leak(rng) });
        at_s += uniform(rng, LEAK_LASTS);
    }
}

fn leak(rng: &mut ChaCha8Rng) -> f64 {
    if rng.random() { TIGHT } else { uniform(rng, (0.0, LEAK)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patients() -> impl Iterator<Item = Patient> {
        (0..300).map(|number| Patient::draw(1, number, 3.0))
    }

    #[test]
    fn every_patient_is_valid() {
        for patient in patients() {
            patient.bench.validate().unwrap();
            for (settings, _) in patient.spans(3.0 * 3600.0) {
                assert_eq!(settings.validate(), Ok(()), "patient {}", patient.number);
                assert!(settings.pip <= settings.pressure_limit - LIMIT_MARGIN);
                assert!((0.0..=15.0).contains(&settings.peep) && (8.0..=40.0).contains(&settings.rate));
                assert!(patient.passive_volume_ml(&settings) > 10.0);
            }
            let [airway, outlet] = [
                (patient.bench.sensor.noise_sd_cmh2o, patient.bench.sensor.quantum_cmh2o),
                (patient.bench.outlet_sensor.noise_sd_cmh2o, patient.bench.outlet_sensor.quantum_cmh2o),
            ];
            assert!(airway.1 <= airway.0 && outlet.1 <= outlet.0, "a silent sensor");
        }
    }

    #[test]
    fn half_of_them_breathe_some_close_to_the_set_rate() {
        let breathing: Vec<_> =
            patients().filter(|patient| patient.bench.patient.effort_cmh2o > 0.0).collect();
        assert!((120..=180).contains(&breathing.len()), "{}", breathing.len());
        let close = |patient: &&Patient| {
            let ratio = patient.bench.patient.effort_rate_per_min / f64::from(patient.settings.rate);
            (ratio - 1.0).abs() <= 0.05
        };
        let close = breathing.iter().filter(close).count();
        assert!(close * 4 > breathing.len() && close * 2 < breathing.len(), "{close}");
    }

    #[test]
    fn the_spans_of_the_settings_fill_the_stay() {
        for patient in patients().take(20) {
            let total: f64 = patient.spans(9000.0).map(|(_, seconds)| seconds).sum();
            assert!((total - 9000.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_short_stay_is_the_beginning_of_a_long_one() {
        for number in 0..20 {
            let [short, long] = [1.0, 9.0].map(|hours| Patient::draw(1, number, hours));
            assert!(long.changes.starts_with(&short.changes) && long.changes.len() > short.changes.len());
            let leaks = [&short, &long].map(|patient| &patient.bench.circuit.leak_changes);
            assert!(leaks[1].starts_with(leaks[0]) && leaks[1].len() > leaks[0].len());
            assert_eq!((short.settings, short.seed), (long.settings, long.seed));
            assert_eq!((&short.bench.patient, &short.bench.lung), (&long.bench.patient, &long.bench.lung));
        }
    }

    #[test]
    fn a_patient_depends_on_seed_and_number_only() {
        assert_eq!(Patient::draw(1, 7, 1.0), Patient::draw(1, 7, 1.0));
        assert_ne!(Patient::draw(1, 7, 1.0).bench, Patient::draw(1, 8, 1.0).bench);
        assert_ne!(Patient::draw(1, 7, 1.0).bench, Patient::draw(2, 7, 1.0).bench);
    }
}
