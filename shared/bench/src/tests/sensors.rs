//! The second pressure sensor and the flow sensor on the bench as a whole.

use super::{BIAS, bench, run};
use crate::{BenchConfig, FlowSensorConfig, OutletSensorConfig};

/// A bench whose sensors have no errors.
fn exact() -> BenchConfig {
    let (lag_ms, noise_sd_cmh2o, quantum_cmh2o) = (0.0, 0.0, 0.0);
    let defaults = BenchConfig::default();
    BenchConfig {
        outlet_sensor: OutletSensorConfig { lag_ms, noise_sd_cmh2o, quantum_cmh2o, ..defaults.outlet_sensor },
        flow_sensor: FlowSensorConfig { lag_ms, noise_sd_l_per_s: 0.0, ..defaults.flow_sensor },
        ..defaults
    }
}

#[test]
fn the_outlet_reads_the_airway_and_the_drop_along_the_tube() {
    let mut bench = bench(&exact());
    for ms in 0..2_000 {
        let truth = run(&mut bench, 40.0, ms > 1_000, 1);
        let expected = truth.airway_pressure + 3.0 * truth.flow_valve;
        assert!((f64::from(bench.outlet_reading()) - expected).abs() < 1e-5, "{ms} ms");
    }
    assert!(bench.truth().flow_valve > 0.1);
}

#[test]
fn the_flow_sensor_reads_lung_and_leak_in_both_directions() {
    let mut config = exact();
    config.circuit.leak_l_per_s_at_30_cmh2o = 0.3;
    let mut bench = bench(&config);
    let mut flows = Vec::new();
    for ms in 0..2_000 {
        let (u_in, u_out) = if ms < 1_000 { (30.0, false) } else { (0.0, true) };
        let truth = run(&mut bench, u_in, u_out, 1);
        let flow = f64::from(bench.flow_reading());
        assert!((flow - truth.flow_lung - truth.flow_leak).abs() < 1e-6, "{ms} ms");
        flows.push(flow);
    }
    assert!(flows[200] > 0.2 && flows[1_100] < -0.05, "{} {}", flows[200], flows[1_100]);
}

#[test]
fn a_sensor_that_is_not_present_reads_no_number() {
    let mut config = BenchConfig::default();
    (config.outlet_sensor.present, config.flow_sensor.present) = (false, false);
    let mut bench = bench(&config);
    bench.step(BIAS, true);
    assert!(bench.outlet_reading().is_nan() && bench.flow_reading().is_nan());
}

#[test]
fn reading_one_sensor_does_not_change_the_noise_of_another() {
    let mut all = bench(&BenchConfig::default());
    let mut airway = all.clone();
    let mut flow = all.clone();
    for _ in 0..2_000 {
        let pressure = all.step(20.0, false);
        all.outlet_reading();
        assert_eq!(airway.step(20.0, false).to_bits(), pressure.to_bits());
        flow.step(20.0, false);
        assert_eq!(all.flow_reading().to_bits(), flow.flow_reading().to_bits());
    }
}

#[test]
fn the_noise_of_no_two_sensors_is_the_same() {
    let mut config = exact();
    for noise_sd in [&mut config.sensor.noise_sd_cmh2o, &mut config.outlet_sensor.noise_sd_cmh2o] {
        *noise_sd = 0.005;
    }
    (config.sensor.lag_ms, config.sensor.quantum_cmh2o) = (0.0, 0.0);
    config.flow_sensor.noise_sd_l_per_s = 0.005;
    let mut bench = bench(&config);
    let mut products = [0.0; 3];
    for _ in 0..20_000 {
        let airway = f64::from(bench.step(0.0, true)) - bench.truth().airway_pressure;
        let outlet = f64::from(bench.outlet_reading()) - bench.truth().airway_pressure;
        let flow = f64::from(bench.flow_reading()) - bench.truth().flow_lung - bench.truth().flow_leak;
        for (sum, product) in products.iter_mut().zip([airway * outlet, airway * flow, outlet * flow]) {
            *sum += product;
        }
    }
    // The standard error of a correlation is 0.007; the bound is five of them.
    let correlations = products.map(|sum| sum / 20_000.0 / 0.005_f64.powi(2));
    assert!(correlations.iter().all(|correlation| correlation.abs() < 0.035), "{correlations:?}");
}
