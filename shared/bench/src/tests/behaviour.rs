//! Patient, units, noise: differences between runs, and what must stay the same.

use super::{BIAS, PEEP, bench, plain, run};
use crate::unit::Unit;
use crate::{Bench, BenchConfig, PatientConfig, STEP_S};

mod patient_activity {
    use super::*;

    /// Largest difference in airway pressure from the same bench with a passive patient, by ms.
    fn differences(config: &BenchConfig, steps: u32) -> Vec<f64> {
        let passive = BenchConfig { patient: PatientConfig::default(), ..config.clone() };
        let (mut active, mut passive) = (bench(config), bench(&passive));
        (0..steps)
            .map(|_| {
                active.step(8.0, false);
                passive.step(8.0, false);
                active.truth().airway_pressure - passive.truth().airway_pressure
            })
            .collect()
    }

    #[test]
    fn effort_lowers_the_airway_pressure() {
        let mut config = BenchConfig::default();
        config.patient.effort_cmh2o = 10.0;
        let differences = differences(&config, 800);
        assert!(differences.iter().all(|d| *d < 1e-9));
        assert!(differences[400] < -5.0, "{}", differences[400]);
    }

    #[test]
    fn cough_raises_the_airway_pressure_while_it_lasts() {
        let mut config = BenchConfig::default();
        config.patient.cough_cmh2o = 50.0;
        config.patient.cough_at_s = 0.5;
        let differences = differences(&config, 800);
        assert!(differences[..500].iter().all(|d| d.abs() < 1e-12));
        assert!(differences[650] > 20.0, "{}", differences[650]);
    }

    /// Pressure drop across the resistor per flow, and rise of volume per pressure, in one breath.
    fn breath(bench: &mut Bench) -> (f64, f64) {
        let start = bench.truth();
        let inspired = run(bench, 15.0, false, 800);
        let resistance = (inspired.airway_pressure - inspired.alveolar_pressure) / inspired.flow_lung;
        let before = start.alveolar_pressure;
        let compliance =
            (inspired.lung_volume_ml - start.lung_volume_ml) / (inspired.alveolar_pressure - before);
        run(bench, BIAS, true, 6_000);
        (resistance, compliance)
    }

    #[test]
    fn resistance_changes_at_the_stated_breath() {
        let mut config = plain(20.0, 50.0);
        config.patient = PatientConfig { change_at_breath: 3, resistance_factor: 2.5, ..config.patient };
        let mut bench = bench(&config);
        for expected in [20.0, 20.0, 50.0, 50.0] {
            let (resistance, _) = breath(&mut bench);
            assert!((resistance / expected - 1.0).abs() < 0.02, "{resistance} instead of {expected}");
        }
    }

    #[test]
    fn compliance_changes_at_the_stated_breath_without_a_jump_of_pressure() {
        let mut config = plain(20.0, 50.0);
        config.patient = PatientConfig { change_at_breath: 2, compliance_factor: 0.5, ..config.patient };
        let mut bench = bench(&config);
        let (_, first) = breath(&mut bench);
        assert!((first / 50.0 - 1.0).abs() < 1e-6, "{first}");
        let before = bench.truth();
        let after = run(&mut bench, BIAS, false, 1);
        assert!((after.alveolar_pressure - before.alveolar_pressure).abs() < 0.05);
        assert!((after.lung_volume_ml / before.lung_volume_ml - 0.5).abs() < 0.01);
        run(&mut bench, BIAS, true, 1_000);
        let (_, second) = breath(&mut bench);
        assert!((second / 25.0 - 1.0).abs() < 1e-6, "{second}");
    }
}

mod units {
    use super::*;

    fn unit(number: u32) -> BenchConfig {
        let mut config = plain(20.0, 20.0);
        config.unit.number = number;
        config.sensor.noise_sd_cmh2o = 0.0;
        config.sensor.quantum_cmh2o = 0.0;
        config
    }

    #[test]
    fn sensor_offset_shows_in_the_reading_and_nowhere_else() {
        for number in 1..20 {
            let config = unit(number);
            let mut bench = bench(&config);
            let reading = f64::from(bench.step(0.0, true));
            let offset = Unit::draw(&config.unit, STEP_S).sensor_offset;
            assert!((reading - f64::from(PEEP) - offset).abs() < 1e-5);
            assert!((bench.truth().sensor_pressure - f64::from(PEEP)).abs() < 1e-12);
        }
    }

    #[test]
    fn flow_gain_scales_the_flow() {
        let flow = |number| run(&mut bench(&unit(number)), 50.0, true, 500).flow_valve;
        for number in 1..20 {
            let gain = Unit::draw(&unit(number).unit, STEP_S).flow_gain;
            // Back-pressure cancels a little of the gain.
            assert!((flow(number) / flow(0) - gain).abs() < 0.02 * (gain - 1.0).abs() + 1e-6, "{number}");
        }
    }

    #[test]
    fn dead_time_differs_by_the_drawn_amount() {
        for number in 0..20 {
            let config = unit(number);
            let mut bench = bench(&config);
            let first_motion = (0..40).find(|_| run(&mut bench, 50.0, true, 1).valve_position > 0.0).unwrap();
            let drawn = 12.0 + Unit::draw(&config.unit, STEP_S).dead_time_ms;
            let rounded = (drawn * 4.0).round() / 4.0;
            assert_eq!(first_motion, rounded.floor() as i32, "unit {number}, {drawn} ms");
        }
    }

    #[test]
    fn drift_moves_the_reading() {
        let mut config = unit(0);
        config.unit.sensor_drift_cmh2o_per_hour = 10.0;
        let mut bench = bench(&config);
        let first = bench.step(0.0, true);
        run(&mut bench, 0.0, true, 35_999);
        let last = bench.step(0.0, true);
        assert!((last - first - 0.1).abs() < 1e-3, "{first} {last}");
    }
}

mod repetition {
    use super::*;

    /// Bits of the readings over two breaths.
    fn readings(config: &BenchConfig, seed: u64) -> Vec<u32> {
        let mut bench = Bench::new(config, PEEP, seed).unwrap();
        let commands = (0..4_000).map(|ms| if ms % 2_000 < 700 { (22.0, false) } else { (BIAS, true) });
        commands.map(|(u_in, u_out)| bench.step(u_in, u_out).to_bits()).collect()
    }

    #[test]
    fn same_seed_same_bits() {
        let config = BenchConfig::default();
        assert_eq!(readings(&config, 7), readings(&config, 7));
        assert_ne!(readings(&config, 7), readings(&config, 8));
    }

    #[test]
    fn a_clone_goes_on_with_the_same_bits() {
        let mut original = bench(&BenchConfig::default());
        run(&mut original, 25.0, false, 300);
        let mut copy = original.clone();
        for _ in 0..300 {
            assert_eq!(original.step(10.0, true).to_bits(), copy.step(10.0, true).to_bits());
        }
        assert_eq!(original.truth(), copy.truth());
    }

    #[test]
    fn time_is_counted_in_steps() {
        let mut bench = bench(&BenchConfig::default());
        run(&mut bench, 0.0, true, 2_500);
        assert!((bench.time_s() - 2.5).abs() < 1e-12);
    }
}
