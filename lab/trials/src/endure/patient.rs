//! The patients: lung, breathing, machine and settings, each drawn from the seed and the patient's number alone.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use shared::settings::Settings;

use super::behaviour::{TIGHT, behave, leaks};
use super::chance::{apart, normal, uniform};
use super::operator;
pub use super::operator::SettingsChange;
use super::slow_fault;
use super::ward::Kind;
use crate::faults::volume::{VolumeLimits, passive_volume_ml};
use plant::bench::{BenchConfig, Failure, Faulty};

/// Standard deviation of the outlet sensor's noise, cmH2O; the family draws that of the airway sensor.
const NOISE: (f64, f64) = (0.03, 0.2);
/// Quantum of the pressure sensors, cmH2O; never above the noise, so that no sound sensor is silent.
const QUANTUM: (f64, f64) = (0.01, 0.1);
/// Spread of the outlet sensor's offset, cmH2O, and of the flow sensor's gain, percent (sd).
const OUTLET_OFFSET: f64 = 0.3;
const FLOW_GAIN: f64 = 3.0;
/// Alarm limits of the volumes, as factors on what the passive lung gets.
const LIMITS: VolumeLimits = VolumeLimits { tidal: (0.5, 2.5), minute: (0.5, 2.5) };

/// A patient at a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Patient {
    /// Number, from 0.
    pub number: u64,
    /// Whether it is a newborn.
    pub newborn: bool,
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

impl Patient {
    /// Draws the patient of this number, for a stay of some hours. The beginning of a longer stay is the shorter one.
    pub fn draw(seed: u64, number: u64, hours: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(number);
        let kind = Kind::draw(&mut rng);
        let mut bench = kind.bench(&mut rng);
        bench.name = format!("patient {number}");
        let settings = kind.prescription(&mut rng, &bench);
        machine(&mut rng, &mut bench);
        behave(&mut rng, kind, &mut bench, f64::from(settings.rate));
        let noise = rng.random();
        // As many draws as the stay is long.
        let [mut of_leaks, mut of_changes, mut of_faults] = [(); 3].map(|()| apart(&mut rng));
        leaks(&mut of_leaks, kind, &mut bench, hours);
        let mut changes = operator::changes(&mut of_changes, kind, &bench, settings, hours);
        for change in &mut changes {
            change.settings = LIMITS.of(&bench, change.settings);
        }
        let settings = LIMITS.of(&bench, settings);
        slow_fault::add(&mut of_faults, &mut bench);
        Self { number, newborn: kind.newborn, bench, settings, changes, seed: noise, failure: None }
    }

    /// All settings with their durations in a stay of some seconds.
    pub fn spans(&self, seconds: f64) -> impl Iterator<Item = (Settings, f64)> {
        let starts = std::iter::once((0.0, self.settings))
            .chain(self.changes.iter().map(|change| (change.at_s, change.settings)));
        let ends = self.changes.iter().map(|change| change.at_s).chain(std::iter::once(f64::INFINITY));
        starts.zip(ends).map(move |((from, settings), to)| (settings, (to.min(seconds) - from).max(0.0)))
    }

    /// The same lung and machine with a passive patient, a tight circuit, and without anything that changes or fails.
    pub fn passive_bench(&self) -> BenchConfig {
        let mut bench = self.bench.clone();
        bench.circuit.leak_l_per_s_at_30_cmh2o = TIGHT;
        bench.circuit.leak_changes = Vec::new();
        bench.patient = BenchConfig::default().patient;
        bench.faults = Vec::new();
        bench
    }

    /// Least volume of a passive breath in a stay of some seconds, mL: at any of the settings, on the lung and tube as they are in the end.
    pub fn least_volume_ml(&self, seconds: f64) -> f64 {
        let mut bench = self.passive_bench();
        let lung = &mut bench.lung.first;
        let growth = 0.01 * self.bench.patient.resistance_growth_percent_per_hour;
        lung.resistance_cmh2o_per_l_s *= 1.0 + growth * seconds / 3600.0;
        let mut narrowed = 1.0_f64;
        for fault in self.bench.faults.iter().filter(|fault| fault.from_s < seconds) {
            match fault.what {
                Faulty::Lung { resistance, compliance } => {
                    lung.resistance_cmh2o_per_l_s *= resistance;
                    lung.compliance_ml_per_cmh2o *= compliance;
                }
                Faulty::Part(Failure::TubeNarrowed(factor)) => narrowed = factor,
                _ => {}
            }
        }
        lung.resistance_cmh2o_per_l_s *= narrowed;
        let volumes = self.spans(seconds).map(|(settings, _)| passive_volume_ml(&bench, &settings));
        volumes.fold(f64::INFINITY, f64::min)
    }

    /// Volume of a breath of the passive lung at these settings once breath follows breath evenly, mL.
    pub fn passive_volume_ml(&self, settings: &Settings) -> f64 {
        passive_volume_ml(&self.bench, settings)
    }
}

/// The machine's deviations and its sensors, as far as the family does not draw them.
fn machine(rng: &mut ChaCha8Rng, bench: &mut BenchConfig) {
    bench.unit.number = rng.random_range(1..100_000);
    bench.outlet_sensor.noise_sd_cmh2o = uniform(rng, NOISE);
    let noises = [bench.sensor.noise_sd_cmh2o, bench.outlet_sensor.noise_sd_cmh2o];
    [bench.sensor.quantum_cmh2o, bench.outlet_sensor.quantum_cmh2o] =
        noises.map(|noise| uniform(rng, (QUANTUM.0, QUANTUM.1.min(noise))));
    bench.outlet_sensor.offset_cmh2o = normal(rng, OUTLET_OFFSET);
    bench.flow_sensor.gain_error_percent = normal(rng, FLOW_GAIN);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::endure::ramp::lasting;

    fn patients() -> impl Iterator<Item = Patient> {
        (0..300).map(|number| Patient::draw(1, number, 3.0))
    }

    #[test]
    fn every_patient_is_valid() {
        for patient in patients() {
            patient.bench.validate().unwrap();
            for (settings, _) in patient.spans(3.0 * 3600.0) {
                assert_eq!(settings.validate(), Ok(()), "patient {}", patient.number);
                assert!(patient.passive_volume_ml(&settings) >= 5.0);
            }
            let [airway, outlet] = [
                (patient.bench.sensor.noise_sd_cmh2o, patient.bench.sensor.quantum_cmh2o),
                (patient.bench.outlet_sensor.noise_sd_cmh2o, patient.bench.outlet_sensor.quantum_cmh2o),
            ];
            assert!(airway.1 <= airway.0 && outlet.1 <= outlet.0, "a silent sensor");
        }
    }

    #[test]
    fn the_least_volume_is_that_of_the_narrowed_tube_and_the_stiffened_lung() {
        let mut patient = Patient::draw(1, 0, 0.1);
        (patient.bench, patient.changes) = (BenchConfig::paper(20.0, 20.0), Vec::new());
        let sound = patient.least_volume_ml(3600.0);
        assert!((sound - patient.passive_volume_ml(&patient.settings)).abs() < 1e-9);
        patient.bench.faults = vec![
            lasting(100.0, Faulty::Lung { resistance: 1.0, compliance: 0.5 }),
            lasting(4000.0, Faulty::Part(Failure::TubeNarrowed(30.0))),
        ];
        let stiff = patient.least_volume_ml(3600.0);
        assert!(stiff < 0.8 * sound && patient.least_volume_ml(5000.0) < 0.3 * stiff);
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
