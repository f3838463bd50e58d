//! What latches and what must not: only valves that do not obey end ventilation. A patient who strains, a PEEP valve that is stuck,
//! a soft lung behind a resistance and pressure sensors that both stand still do not. Verifies: hard-limit, sustained-pressure.

use super::hostile::SOUND;
use super::rig::Attended;
use plant::bench::{BenchConfig, BenchPlant, Failure};
use rayon::prelude::*;
use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::device::prescription::PrescriptionMemory;
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::sensor::Readings;
use shared::settings::Settings;
use shared::ventilator::Mode;

/// A fast and a slow PID.
const GAINS: [PidGains; 2] = [SOUND, PidGains { p: 3.0, i: 30.0, d: 0.0 }];
/// Time of the fault, in an expiration, and of the end, ms.
const FAULT_MS: u32 = 13_500;
const END_MS: u32 = 45_000;
/// Time after the fault from which the volume is judged, ms: four breaths.
const JUDGED_MS: u32 = 12_000;

/// A machine with a fault.
#[derive(Clone)]
struct Course {
    bench: BenchConfig,
    settings: Settings,
    failure: Option<Failure>,
    /// Distorts the readings from the fault on, at each millisecond.
    distort: fn(u32, &mut Readings),
}

/// What has become of it.
#[derive(Clone, Debug, Default)]
struct Outcome {
    latched: Option<(Fault, u32)>,
    alarms: Vec<Fault>,
    /// Highest true pressure after the fault, cmH2O, and the time above the limit, ms.
    peak: f64,
    above_ms: u32,
    /// Gas that the lung took in from [`JUDGED_MS`] after the fault on, mL.
    volume: f64,
}

/// Readings are left as they are.
fn sound(_: u32, _: &mut Readings) {}

impl Course {
    fn new(bench: BenchConfig, pip: f32, pressure_limit: f32) -> Self {
        let settings = Settings { pressure_limit, ..paper_settings(pip) };
        Self { bench, settings, failure: None, distort: sound }
    }

    fn run(&self, gains: PidGains) -> Outcome {
        let controller = Controller::Pid(Pid::new(gains, DEFAULT_PERIOD_US).unwrap());
        let memory = PrescriptionMemory::new();
        let plant = BenchPlant::at_rest(&self.bench, self.settings.peep, 1).unwrap();
        let mut device = Attended::started(&memory, plant, &controller, &self.settings, Monitors::ALL, None);
        let (mut outcome, mut last) = (Outcome::default(), None);
        for ms in 0..END_MS {
            let mut readings = device.rig.readings();
            if let (FAULT_MS, Some(failure)) = (ms, self.failure) {
                device.rig.plant.bench.fail(failure);
            }
            if ms >= FAULT_MS {
                (self.distort)(ms, &mut readings);
            }
            let output = device.step(readings, 0);
            outcome.alarms.extend(output.alarm);
            if let Mode::Fault(fault) = output.mode {
                outcome.latched.get_or_insert((fault, ms - FAULT_MS));
            }
            device.rig.run_plant();
            let truth = device.rig.plant.bench.truth();
            let volume = truth.lung_volume_ml;
            if ms >= FAULT_MS {
                outcome.peak = outcome.peak.max(truth.airway_pressure);
                outcome.above_ms +=
                    u32::from(truth.airway_pressure > f64::from(self.settings.pressure_limit));
            }
            if ms >= FAULT_MS + JUDGED_MS {
                outcome.volume += (volume - last.unwrap_or(volume)).max(0.0);
            }
            last = Some(volume);
        }
        outcome
    }

    /// Share of the volume that the same patient gets without the fault, and the outcome.
    fn share(&self, gains: PidGains) -> (f64, Outcome) {
        let outcome = self.run(gains);
        let without = Self { failure: None, distort: sound, ..self.clone() }.run(gains);
        (outcome.volume / without.volume, outcome)
    }
}

/// The courses that fail a requirement, under both PIDs.
#[track_caller]
fn all(courses: impl IntoIterator<Item = Course>, holds: impl Fn(f64, &Outcome) -> bool + Sync) {
    let runs: Vec<_> =
        courses.into_iter().flat_map(|course| GAINS.map(|gains| (course.clone(), gains))).collect();
    let failed: Vec<_> = runs
        .into_par_iter()
        .filter_map(|(course, gains)| {
            let (share, outcome) = course.share(gains);
            let name = &course.bench.name;
            (!holds(share, &outcome))
                .then(|| format!("{name} PIP {} P {}: {share:.2} {outcome:?}", course.settings.pip, gains.p))
        })
        .collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

/// A patient who strains once, with this pressure and for this time.
fn straining(resistance: f64, compliance: f64, peak: f64, duration_s: f64) -> BenchConfig {
    let mut bench = BenchConfig::paper(resistance, compliance);
    bench.patient.cough_cmh2o = peak;
    (bench.patient.cough_at_s, bench.patient.cough_duration_s) = (f64::from(FAULT_MS) * 1e-3, duration_s);
    bench
}

/// A patient who triggers 24 times a minute.
fn breathing(resistance: f64, compliance: f64) -> BenchConfig {
    let mut bench = BenchConfig::paper(resistance, compliance);
    (bench.patient.effort_cmh2o, bench.patient.effort_rate_per_min) = (5.0, 24.0);
    bench
}

#[test]
fn a_patient_who_strains_for_seconds_is_ventilated_from_the_next_breath_on() {
    let strains = [
        (5.0, 50.0, 100.0, 3.0, 40.0),
        (5.0, 100.0, 80.0, 3.0, 40.0),
        (3.0, 60.0, 80.0, 3.0, 35.0),
        (5.0, 50.0, 80.0, 3.0, 30.0),
        (5.0, 50.0, 120.0, 4.0, 45.0),
        (2.0, 100.0, 120.0, 5.0, 40.0),
    ];
    let flows: [fn(u32, &mut Readings); 2] = [sound, |_, readings| readings.flow = f32::NAN];
    let courses = strains.into_iter().flat_map(|(resistance, compliance, peak, duration_s, limit)| {
        let bench = straining(resistance, compliance, peak, duration_s);
        flows.map(|distort| Course { distort, ..Course::new(bench.clone(), 20.0, limit) })
    });
    all(courses, |share, outcome| outcome.latched.is_none() && share > 0.8);
    // Above its limit for longer than a cough, the pressure is an alarm by its name.
    let alarm = Course::new(straining(2.0, 100.0, 120.0, 5.0), 20.0, 40.0).run(SOUND).alarms;
    assert!(alarm.contains(&Fault::HighPressure) && !alarm.contains(&Fault::HardLimit), "{alarm:?}");
}

#[test]
fn both_valves_stuck_latch_within_seconds() {
    let courses = BenchConfig::paper_lungs().into_iter().map(|bench| {
        let failure = Some(Failure::BothValvesStuck(80.0));
        Course { failure, ..Course::new(bench, 20.0, 40.0) }
    });
    all(courses, |_, outcome| {
        outcome.latched.is_some_and(|(fault, ms)| fault == Fault::HardLimit && ms < 3000)
    });
}

/// Noise of a working sensor.
fn noise(ms: u32, sensor: u32) -> f32 {
    0.07 * ((ms * 7 % (5 + 2 * sensor)) as f32 - 2.0)
}

/// Both pressure sensors read a constant with the noise of working sensors.
macro_rules! constant {
    ($pressure:expr) => {
        |ms, readings: &mut Readings| {
            (readings.airway, readings.outlet) = ($pressure + noise(ms, 0), $pressure + noise(ms, 1));
        }
    };
}

#[test]
fn two_sensors_that_stand_still_are_lost_and_ventilation_goes_on_by_the_flow() {
    let constants: [fn(u32, &mut Readings); 5] =
        [constant!(5.0), constant!(10.0), constant!(15.0), constant!(20.0), constant!(24.0)];
    let lungs = [(5.0, 50.0), (20.0, 20.0), (50.0, 10.0), (20.0, 50.0)];
    let courses = lungs.into_iter().flat_map(|(resistance, compliance)| {
        constants.map(|distort| Course {
            distort,
            ..Course::new(BenchConfig::paper(resistance, compliance), 20.0, 40.0)
        })
    });
    all(courses, |share, outcome| {
        let alarmed = outcome.alarms.contains(&Fault::NoResponse);
        let goes_on = outcome.latched.is_none() && (0.8..1.2).contains(&share);
        alarmed && goes_on && outcome.above_ms < 300
    });
}

#[test]
fn pip_follows_a_stuck_peep_valve_whether_the_patient_triggers_or_not() {
    let lungs = [(5.0, 10.0), (20.0, 20.0), (50.0, 10.0), (20.0, 50.0)];
    let courses = lungs.into_iter().flat_map(|(resistance, compliance)| {
        let benches = [BenchConfig::paper(resistance, compliance), breathing(resistance, compliance)];
        [(15.0, 25.0), (16.0, 20.0), (18.0, 20.0)].into_iter().flat_map(move |(valve, pip)| {
            benches.clone().map(|bench| {
                let failure = Some(Failure::PeepValveStuck(valve));
                Course { failure, ..Course::new(bench, pip, 60.0) }
            })
        })
    });
    all(courses, |share, outcome| outcome.latched.is_none() && share > 0.8);
}

#[test]
fn a_lung_behind_a_resistive_filter_is_not_latched_and_pip_does_not_follow_it() {
    let courses =
        [(5.0, 200.0), (20.0, 100.0), (20.0, 50.0)].into_iter().flat_map(|(resistance, compliance)| {
            [BenchConfig::paper(resistance, compliance), breathing(resistance, compliance)].map(
                |mut bench| {
                    bench.expiratory.laminar_resistance_cmh2o_per_l_s = 50.0;
                    bench.expiratory.orifice_l_per_s_per_sqrt_cmh2o = 0.05;
                    Course::new(bench, 20.0, 60.0)
                },
            )
        });
    all(courses, |_, outcome| outcome.latched.is_none() && outcome.peak < 26.0);
}
