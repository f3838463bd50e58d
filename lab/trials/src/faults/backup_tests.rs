//! Backup ventilation after a change of the timing, and a flow sensor that stands still, on lungs of the paper.
//! Verifies: backup-ventilation.

use super::cases::LIMIT;
use super::hostile::sound_controller;
use super::rig::Attended;
use plant::bench::{BenchConfig, BenchPlant, Failure};
use rayon::prelude::*;
use shared::breath::paper_settings;
use shared::device::prescription::PrescriptionMemory;
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::sensor::Readings;
use shared::settings::Settings;

/// Time of the fault, in the middle of an inspiration, and of the new settings, ms.
const FAULT_MS: u32 = 18_400;
/// End of a course, ms.
const END_MS: u32 = 60_000;
/// Time after the fault from which its breaths are counted, ms: the settings take effect with a breath.
const COUNTED_MS: u32 = 3000;

/// Gas that the circuit holds at the end of an inspiration, and then gives to a slow lung if the inspiration goes on, mL.
const CIRCUIT_ML: f64 = 30.0;

/// What a lung got after the fault.
struct Course {
    /// Highest true pressure at the airway, cmH2O.
    peak: f64,
    /// Highest volume of the lung above its lowest one, mL: that of a breath.
    largest: f64,
    /// Alarms, with the time since the fault, ms.
    alarms: Vec<(Fault, u32)>,
}

impl Course {
    /// When an alarm came first, ms after the fault.
    fn first(&self, fault: Fault) -> Option<u32> {
        self.alarms.iter().find(|(found, _)| *found == fault).map(|(_, ms)| *ms)
    }
}

/// Readings from the true ones, and the time since the fault, ms.
type Distortion = fn(Readings, u32) -> Readings;

/// A machine with a fault.
fn course(lung: &BenchConfig, later: &Settings, failure: Option<Failure>, readings: Distortion) -> Course {
    let settings = Settings { pressure_limit: later.pressure_limit, ..paper_settings(25.0) };
    let (controller, memory) = (sound_controller().unwrap(), PrescriptionMemory::new());
    let plant = BenchPlant::at_rest(lung, settings.peep, 1).unwrap();
    let mut device = Attended::started(&memory, plant, &controller, &settings, Monitors::ALL, None);
    let mut course = Course { peak: 0.0, largest: 0.0, alarms: Vec::new() };
    let mut lowest = f64::INFINITY;
    for ms in 0..END_MS {
        if ms == FAULT_MS {
            if let Some(failure) = failure {
                device.rig.plant.bench.fail(failure);
            }
            device.apply(*later);
        }
        let mut seen = device.rig.readings();
        if let Some(since) = ms.checked_sub(FAULT_MS) {
            seen = readings(seen, since);
        }
        let output = device.step(seen, 0);
        course.alarms.extend(output.alarm.map(|fault| (fault, ms.saturating_sub(FAULT_MS))));
        device.rig.run_plant();
        if ms >= FAULT_MS + COUNTED_MS {
            let truth = device.rig.plant.bench.truth();
            course.peak = course.peak.max(truth.airway_pressure);
            lowest =
                if output.command.u_out() { truth.lung_volume_ml } else { lowest.min(truth.lung_volume_ml) };
            course.largest = course.largest.max(truth.lung_volume_ml - lowest);
        }
    }
    course
}

fn none(_: Readings, _: u32) -> Readings {
    Readings::from(f32::NAN)
}

fn no_pressure(readings: Readings, _: u32) -> Readings {
    Readings { flow: readings.flow, ..Readings::from(f32::NAN) }
}

fn lungs() -> Vec<BenchConfig> {
    let lungs = [(5.0, 10.0), (5.0, 50.0), (20.0, 20.0), (50.0, 10.0), (50.0, 50.0), (20.0, 50.0)];
    lungs.iter().map(|(r, c)| BenchConfig::paper(*r, *c)).collect()
}

/// In all lungs with all of these, at the same time; what `judge` objects to.
fn objections<T: Sync>(all: &[T], judge: impl Fn(&BenchConfig, &T) -> Option<String> + Sync) -> Vec<String> {
    let lungs = lungs();
    let runs: Vec<_> = lungs.iter().flat_map(|lung| all.iter().map(move |one| (lung, one))).collect();
    runs.into_par_iter()
        .filter_map(|(lung, one)| judge(lung, one).map(|what| format!("{}: {what}", lung.name)))
        .collect()
}

#[test]
fn backup_ventilation_keeps_the_volume_and_the_limit_whatever_the_inspiratory_time() {
    let timings = [(20.0, 2.4), (20.0, 2.0), (12.0, 3.0), (10.0, 5.0), (20.0, 0.4), (30.0, 0.2), (20.0, 1.0)];
    let runs: Vec<_> = timings
        .into_iter()
        .flat_map(|timing| [LIMIT, 60.0].map(|limit| (timing, limit)))
        .flat_map(|run| [none as Distortion, no_pressure].map(|readings| (run, readings)))
        .collect();
    let found = objections(&runs, |lung, (((rate, inspiratory_time), pressure_limit), readings)| {
        let settings = Settings { pressure_limit: *pressure_limit, ..paper_settings(25.0) };
        let later = Settings { rate: *rate, inspiratory_time: *inspiratory_time, fall_time: 0.2, ..settings };
        let usual = course(lung, &settings, None, |readings, _| readings);
        let backup = course(lung, &later, None, *readings);
        let is_right = backup.peak <= f64::from(*pressure_limit) + 5.0
            && backup.largest <= 1.05 * usual.largest + CIRCUIT_ML;
        (!is_right).then(|| {
            format!(
                "Ti {inspiratory_time}, limit {pressure_limit}: {} cmH2O, {} of {} mL",
                backup.peak, backup.largest, usual.largest
            )
        })
    });
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn an_occlusion_is_found_within_ten_seconds_whatever_a_flow_sensor_shows_that_stands_still() {
    // Noise of a flow that does not change.
    fn noise(since: u32) -> f32 {
        0.005 * ((since * 7 % 11) as f32 - 5.0) / 3.0
    }
    let sensors: [(&str, Distortion); 8] = [
        ("0.0", |readings, _| Readings { flow: 0.0, ..readings }),
        ("0.02", |readings, _| Readings { flow: 0.02, ..readings }),
        ("0.1", |readings, _| Readings { flow: 0.1, ..readings }),
        ("0.6", |readings, _| Readings { flow: 0.6, ..readings }),
        ("-0.1", |readings, _| Readings { flow: -0.1, ..readings }),
        ("0.02 with noise", |readings, since| Readings { flow: 0.02 + noise(since), ..readings }),
        ("0.3 with noise", |readings, since| Readings { flow: 0.3 + noise(since), ..readings }),
        ("no number", |readings, _| Readings { flow: f32::NAN, ..readings }),
    ];
    let settings = Settings { pressure_limit: LIMIT, ..paper_settings(25.0) };
    let found = objections(&sensors, |lung, (name, readings)| {
        let occluded = course(lung, &settings, Some(Failure::TubeOccluded), *readings);
        let first = occluded.first(Fault::Occlusion);
        first.is_none_or(|ms| ms > 10_000).then(|| format!("{name}: {:?}", occluded.alarms))
    });
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn without_a_pressure_reading_the_flow_sensor_reveals_an_occluded_tube() {
    let settings = Settings { pressure_limit: LIMIT, ..paper_settings(25.0) };
    let found = objections(&[()], |lung, ()| {
        let occluded = course(lung, &settings, Some(Failure::TubeOccluded), no_pressure);
        let open = course(lung, &settings, None, no_pressure);
        let is_right = occluded.first(Fault::Occlusion).is_some_and(|ms| ms <= 10_000)
            && open.first(Fault::Occlusion).is_none();
        (!is_right).then(|| format!("{:?}, open: {:?}", occluded.alarms, open.alarms))
    });
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn a_wrong_flow_sensor_is_not_used_and_a_sound_one_is() {
    let sensors: [(&str, bool, Distortion); 11] = [
        ("reversed", true, |readings, _| Readings { flow: -readings.flow, ..readings }),
        ("a gain of 0.4", true, |readings, _| Readings { flow: 0.4 * readings.flow, ..readings }),
        ("a gain of 2.5", true, |readings, _| Readings { flow: 2.5 * readings.flow, ..readings }),
        ("an offset of 0.4 L/s", true, |readings, _| Readings { flow: readings.flow + 0.4, ..readings }),
        ("an offset of -0.2 L/s", true, |readings, _| Readings { flow: readings.flow - 0.2, ..readings }),
        ("frozen", true, |readings, _| Readings { flow: 0.1, ..readings }),
        ("a gain of 1.2", false, |readings, _| Readings { flow: 1.2 * readings.flow, ..readings }),
        ("a gain of 0.8", false, |readings, _| Readings { flow: 0.8 * readings.flow, ..readings }),
        ("an offset of 0.05 L/s", false, |readings, _| Readings { flow: readings.flow + 0.05, ..readings }),
        ("an offset of -0.05 L/s", false, |readings, _| Readings { flow: readings.flow - 0.05, ..readings }),
        ("wrong for 9 s", true, |readings, since| {
            let wrong = since < 9000;
            Readings { flow: if wrong { 0.1 } else { readings.flow }, ..readings }
        }),
    ];
    let settings = Settings { pressure_limit: LIMIT, ..paper_settings(25.0) };
    let found = objections(&sensors, |lung, (name, wrong, readings)| {
        let course = course(lung, &settings, None, *readings);
        let high =
            course.alarms.iter().any(|(fault, _)| *fault != Fault::FlowSensorLost && *fault != Fault::Leak);
        let lost = course.first(Fault::FlowSensorLost);
        let is_right = if *wrong { lost.is_some_and(|ms| ms <= 15_000) } else { lost.is_none() };
        (!is_right || high).then(|| format!("{name}: {:?}", course.alarms))
    });
    assert!(found.is_empty(), "{found:#?}");
}
