//! `reading-frozen` on the grid of the paper's lungs, the sensors' noise and their quanta: quiet sensors raise no alarm, and a
//! sensor that freezes is found as soon as the pressure should have changed. Verifies: reading-frozen.

use super::cases::LIMIT;
use super::hostile::sound_controller;
use super::rig::Attended;
use plant::bench::{BenchConfig, BenchPlant};
use rayon::prelude::*;
use shared::breath::{PAPER_PIPS, paper_settings};
use shared::device::prescription::PrescriptionMemory;
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::sensor::Readings;
use shared::settings::Settings;

/// Standard deviations of the noise, cmH2O.
const NOISES: [f64; 5] = [0.003, 0.011, 0.03, 0.1, 0.2];
/// Quanta, cmH2O.
const QUANTA: [f64; 3] = [0.01, 0.043, 0.1];
/// Breaths without an alarm on each lung with each of these sensors: 300 on each lung.
const BREATHS: u32 = 20;
/// A breath, ms.
const BREATH_MS: u32 = 3000;
/// Longest time to detect a frozen sensor, ms.
const WITHIN_MS: u32 = 240;

/// The sensors of a machine.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sensors {
    /// Two pressure sensors and a flow sensor, the first frozen.
    AirwayOfTwo,
    /// The same, the second frozen.
    OutletOfTwo,
    /// The same, both frozen.
    BothOfTwo,
    /// A pressure sensor alone.
    Single,
}

/// Change that the pressure should have made since the freezing when it must be detected, cmH2O: the monitor's bounds and the
/// drop in the tube, whose flow changes by up to 1.5 L/s. Without a sensor that moves, the fall from less than 5 cmH2O above
/// PEEP is not judged.
fn telling(sensors: Sensors) -> f64 {
    match sensors {
        Sensors::AirwayOfTwo | Sensors::OutletOfTwo => 8.0,
        Sensors::BothOfTwo | Sensors::Single => 6.0,
    }
}

fn bench(lung: &BenchConfig, (noise, quantum): (f64, f64), sensors: Sensors) -> BenchConfig {
    let mut bench = lung.clone();
    (bench.sensor.noise_sd_cmh2o, bench.sensor.quantum_cmh2o) = (noise, quantum);
    (bench.outlet_sensor.noise_sd_cmh2o, bench.outlet_sensor.quantum_cmh2o) = (noise, quantum);
    let two = sensors != Sensors::Single;
    (bench.outlet_sensor.present, bench.flow_sensor.present) = (two, two);
    bench
}

fn settings(pip: f32) -> Settings {
    // Clear of the overshoot, which has other alarms.
    Settings { pressure_limit: LIMIT.max(pip + 10.0), ..paper_settings(pip) }
}

/// Runs a machine until a time, ms, with sensors that freeze at another; returns its true pressures and its alarms with
/// their times.
fn course(
    bench: &BenchConfig,
    settings: &Settings,
    until_ms: u32,
    freeze: Option<(u32, Sensors)>,
) -> (Vec<f64>, Vec<(Fault, u32)>) {
    let controller = sound_controller().unwrap();
    let memory = PrescriptionMemory::new();
    let plant = BenchPlant::at_rest(bench, settings.peep, 1).unwrap();
    let mut device = Attended::started(&memory, plant, &controller, settings, Monitors::ALL, None);
    let (mut pressures, mut alarms, mut held) = (Vec::new(), Vec::new(), None);
    for ms in 0..until_ms {
        let mut readings = device.rig.readings();
        if let Some((_, sensors)) = freeze.filter(|(at, _)| ms >= *at) {
            let held: Readings = *held.get_or_insert(readings);
            if sensors != Sensors::OutletOfTwo {
                readings.airway = held.airway;
            }
            if sensors != Sensors::AirwayOfTwo {
                readings.outlet = held.outlet;
            }
        }
        let output = device.step(readings, 0);
        alarms.extend(output.alarm.map(|fault| (fault, ms)));
        device.rig.run_plant();
        pressures.push(device.rig.plant.bench.airway_pressure());
    }
    (pressures, alarms)
}

#[test]
fn hundreds_of_breaths_with_sensors_quiet_or_noisy_coarse_or_fine_raise_no_alarm() {
    let lungs = BenchConfig::paper_lungs();
    let cells: Vec<_> = NOISES.into_iter().flat_map(|noise| QUANTA.map(|quantum| (noise, quantum))).collect();
    let runs: Vec<_> = lungs.iter().flat_map(|lung| cells.iter().map(move |cell| (lung, *cell))).collect();
    let found: Vec<_> = runs
        .into_par_iter()
        .enumerate()
        .filter_map(|(place, (lung, cell))| {
            let settings = settings(PAPER_PIPS[place % PAPER_PIPS.len()]);
            // Every other machine has one pressure sensor, which must do without a witness.
            let sensors = if place % 2 == 0 { Sensors::AirwayOfTwo } else { Sensors::Single };
            let (_, alarms) = course(&bench(lung, cell, sensors), &settings, BREATHS * BREATH_MS, None);
            (!alarms.is_empty()).then(|| format!("{} {sensors:?} {cell:?}: {alarms:?}", lung.name))
        })
        .collect();
    assert!(found.is_empty(), "{found:#?}");
}

/// The time from which a sensor that freezes at a time in the third breath contradicts the pressure of a sound machine, and the
/// time at which it is found, ms.
fn found(bench: &BenchConfig, settings: &Settings, sensors: Sensors, at_ms: u32) -> (u32, Option<u32>) {
    let end_ms = 4 * BREATH_MS;
    let (sound, _) = course(bench, settings, end_ms, None);
    let then = sound[at_ms as usize];
    let changed = |ms: &u32| (sound[*ms as usize] - then).abs() >= telling(sensors);
    let due_ms = (at_ms..end_ms).find(changed).expect("the pressure changes in every breath");
    let (_, alarms) = course(bench, settings, end_ms, Some((at_ms, sensors)));
    let wanted = if sensors == Sensors::OutletOfTwo { Fault::OutletSensorLost } else { Fault::ReadingFrozen };
    (due_ms, alarms.iter().find(|(fault, _)| *fault == wanted).map(|(_, ms)| *ms))
}

fn all_found(sensors: Sensors, cells: &[(f64, f64)]) {
    let lungs = BenchConfig::paper_lungs();
    let every = 70;
    let times = (0..BREATH_MS / every).map(|n| 2 * BREATH_MS + n * every);
    let runs: Vec<_> = times
        .flat_map(|at_ms| lungs.iter().map(move |lung| (lung, at_ms)))
        .zip(cells.iter().cycle().copied())
        .collect();
    let late: Vec<_> = runs
        .into_par_iter()
        .filter_map(|((lung, at_ms), cell)| {
            let settings = settings(25.0);
            let (due_ms, found_ms) = found(&bench(lung, cell, sensors), &settings, sensors, at_ms);
            let in_time = found_ms.is_some_and(|ms| ms <= due_ms + WITHIN_MS);
            (!in_time)
                .then(|| format!("{} {cell:?}: frozen {at_ms}, due {due_ms}, found {found_ms:?}", lung.name))
        })
        .collect();
    assert!(late.is_empty(), "{} late: {late:#?}", late.len());
}

/// Quiet, usual and noisy sensors.
const CELLS: [(f64, f64); 3] = [(0.003, 0.1), (0.1, 0.07), (0.2, 0.01)];

#[test]
fn a_frozen_sensor_is_found_at_any_time_of_the_breath_once_the_pressure_changes() {
    all_found(Sensors::AirwayOfTwo, &CELLS);
    all_found(Sensors::OutletOfTwo, &CELLS);
}

#[test]
fn without_a_sensor_that_moves_the_commands_tell_that_the_pressure_changes() {
    all_found(Sensors::BothOfTwo, &CELLS);
    all_found(Sensors::Single, &CELLS);
}
