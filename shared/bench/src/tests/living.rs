//! A patient who breathes irregularly, coughs and fills with secretions, on a circuit whose leak changes.

use super::{BIAS, PEEP, bench, plain, run};
use crate::{Bench, BenchConfig, LeakChange, PatientConfig, Truth};

/// The state after every ms at PEEP.
fn at_peep(config: &BenchConfig, seed: u64, steps: u32) -> Vec<Truth> {
    let mut bench = Bench::new(config, PEEP, seed).unwrap();
    (0..steps).map(|_| run(&mut bench, BIAS, true, 1)).collect()
}

fn breathing() -> BenchConfig {
    let mut config = BenchConfig::default();
    (config.patient.effort_cmh2o, config.patient.effort_rate_per_min) = (8.0, 15.0);
    config
}

#[test]
fn the_truth_tells_when_an_effort_began() {
    for variability in [0.0, 20.0] {
        let mut config = breathing();
        config.patient.effort_variability_percent = variability;
        let states = at_peep(&config, 1, 60_000);
        for pair in states.windows(2) {
            let begun = pair[1].efforts - pair[0].efforts;
            assert!(begun <= 1);
            if begun == 1 {
                assert!(pair[0].muscle_pressure.abs() < 1e-9 && pair[1].muscle_pressure < 0.2);
                assert!(pair[1].effort_started_s > pair[0].effort_started_s);
            }
        }
        assert!((12..=18).contains(&states.last().unwrap().efforts));
    }
}

#[test]
fn efforts_of_a_variable_patient_differ_and_repeat_with_the_seed() {
    let mut config = breathing();
    config.patient.effort_variability_percent = 20.0;
    let muscle = |seed| at_peep(&config, seed, 20_000).iter().map(|t| t.muscle_pressure).collect::<Vec<_>>();
    assert_eq!(muscle(1), muscle(1));
    assert_ne!(muscle(1), muscle(2));
}

#[test]
fn an_irregular_patient_leaves_the_sensors_noise_as_it_is() {
    // Efforts too small to reach a quantum, so that only the noise can differ.
    let noise = |patient| {
        let mut bench = bench(&BenchConfig { patient, ..BenchConfig::default() });
        (0..5_000).map(|_| bench.step(BIAS, true).to_bits()).collect::<Vec<_>>()
    };
    let irregular = PatientConfig {
        effort_cmh2o: 1e-9,
        effort_variability_percent: 50.0,
        double_efforts_percent: 50.0,
        cough_cmh2o: 1e-9,
        coughs_per_hour: 600.0,
        ..PatientConfig::default()
    };
    let (quiet, irregular) = (noise(PatientConfig::default()), noise(irregular));
    let differing = quiet.iter().zip(&irregular).filter(|(a, b)| a != b).count();
    assert!(differing < 5, "{differing} of 5000");
}

#[test]
fn random_coughs_raise_the_airway_pressure() {
    let mut config = BenchConfig::default();
    (config.patient.cough_cmh2o, config.patient.coughs_per_hour) = (50.0, 600.0);
    let mut bench = bench(&config);
    let mut coughs = 0;
    let mut before = bench.truth();
    for _ in 0..120_000 {
        let now = run(&mut bench, 5.0, true, 1);
        coughs += u32::from(before.muscle_pressure > -25.0 && now.muscle_pressure <= -25.0);
        before = now;
    }
    assert!((8..=35).contains(&coughs), "{coughs} coughs in 2 min at 10 per min");
}

#[test]
fn a_cough_on_request_comes_on_top_of_random_ones() {
    let mut config = BenchConfig::default();
    (config.patient.cough_cmh2o, config.patient.coughs_per_hour) = (10.0, 0.1);
    let mut bench = bench(&config);
    bench.cough(60.0);
    assert!((run(&mut bench, BIAS, true, 150).muscle_pressure + 60.0).abs() < 1e-9);
}

#[test]
fn secretions_raise_the_resistance_of_every_breath() {
    let mut config = plain(20.0, 50.0);
    // A doubling in 6 min makes the change visible in a short test.
    config.patient.resistance_growth_percent_per_hour = 1000.0;
    let mut bench = bench(&config);
    for minute in 0..4_u32 {
        let inspired = run(&mut bench, 15.0, false, 800);
        let found = (inspired.airway_pressure - inspired.alveolar_pressure) / inspired.flow_lung;
        let expected = 20.0 * (1.0 + 10.0 * (f64::from(minute) * 60.0 + 0.8) / 3600.0);
        assert!((found / expected - 1.0).abs() < 0.02, "{found} instead of {expected}");
        run(&mut bench, BIAS, true, 59_200);
    }
}

#[test]
fn the_leak_changes_at_the_stated_time() {
    let mut config = plain(20.0, 20.0);
    config.circuit.leak_changes = vec![
        LeakChange { at_s: 1.0, leak_l_per_s_at_30_cmh2o: 0.3 },
        LeakChange { at_s: 2.0, leak_l_per_s_at_30_cmh2o: 0.0 },
    ];
    let flow: Vec<f64> = at_peep(&config, 1, 3_000).iter().map(|truth| truth.flow_leak).collect();
    assert!(flow[..1000].iter().chain(&flow[2000..]).all(|flow| flow.abs() < 1e-12));
    assert!(flow[1000..2000].iter().all(|flow| *flow > 0.03));
}
