//! Behaviour of the gas on the bench.

use super::{BIAS, PEEP, all_lungs, bench, plain, run, stored_ml};
use crate::{Bench, BenchConfig, CompartmentConfig, STEP_S};

mod rest {
    use super::*;

    #[test]
    fn starts_at_peep_with_volume_compliance_times_pressure() {
        for config in BenchConfig::paper_lungs() {
            let truth = bench(&config).truth();
            let peep = f64::from(PEEP);
            assert!((truth.airway_pressure - peep).abs() < 1e-12);
            assert!((truth.sensor_pressure - peep).abs() < 1e-12);
            assert!((truth.lung_volume_ml - config.lung.first.compliance_ml_per_cmh2o * peep).abs() < 1e-9);
            assert!((truth.expiratory_opening - 1.0).abs() < 1e-12);
            assert!(truth.valve_position.abs() < 1e-12);
        }
    }

    #[test]
    fn stays_there_without_commands_and_leak() {
        let truth = run(&mut bench(&plain(20.0, 20.0)), 0.0, true, 5_000);
        assert!((truth.airway_pressure - f64::from(PEEP)).abs() < 1e-9);
    }

    #[test]
    fn closed_off_lung_settles_at_volume_over_compliance() {
        for config in [plain(5.0, 50.0), plain(20.0, 20.0), plain(50.0, 10.0)] {
            let mut bench = bench(&config);
            run(&mut bench, 35.0, false, 400);
            let truth = run(&mut bench, 0.0, false, 20_000);
            let recoil = truth.lung_volume_ml / config.lung.first.compliance_ml_per_cmh2o;
            assert!(recoil > 7.0 && recoil < config.lung.first.upper_inflection_cmh2o, "{recoil}");
            assert!((truth.airway_pressure - recoil).abs() < 1e-6, "{} {recoil}", truth.airway_pressure);
        }
    }
}

mod flow {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        /// Inflow minus outflow equals the change of volume in circuit and lung.
        #[test]
        fn volume_is_conserved(
            lung in 0..30_usize,
            two_compartments in any::<bool>(),
            effort in 0.0..20.0_f64,
            drawn in 0.0..0.3_f64,
            commands in prop::collection::vec((0.0..100.0_f32, any::<bool>(), 1..300_u32), 1..12),
        ) {
            let mut config = all_lungs().swap_remove(lung);
            config.lung.second = two_compartments.then(CompartmentConfig::default);
            config.patient.effort_cmh2o = effort;
            let mut bench = bench(&config);
            bench.draw(drawn);
            let before = stored_ml(&config, &bench.truth());
            let (mut net_ml, mut into_lung_ml) = (0.0, 0.0);
            let lung_before = bench.truth().lung_volume_ml;
            for (u_in, u_out, steps) in commands {
                for _ in 0..steps {
                    bench.step(u_in, u_out);
                    let t = bench.truth();
                    let net = t.flow_valve - t.flow_expiratory - t.flow_leak - t.flow_relief - drawn;
                    net_ml += 1e3 * net * STEP_S;
                    into_lung_ml += 1e3 * t.flow_lung * STEP_S;
                    prop_assert!(t.flow_valve >= 0.0 && t.flow_expiratory >= 0.0 && t.flow_relief >= 0.0);
                }
            }
            let after = bench.truth();
            prop_assert!((stored_ml(&config, &after) - before - net_ml).abs() < 1e-6);
            prop_assert!((after.lung_volume_ml - lung_before - into_lung_ml).abs() < 1e-6);
        }
    }

    #[test]
    fn lung_empties_with_time_constant_r_times_c() {
        for (resistance, compliance) in [(20.0, 50.0), (50.0, 20.0), (200.0, 3.0)] {
            let mut config = plain(resistance, compliance);
            config.expiratory.orifice_l_per_s_per_sqrt_cmh2o = 5.0;
            config.expiratory.laminar_resistance_cmh2o_per_l_s = 0.01;
            let mut bench = Bench::new(&config, 20.0, 1).unwrap();
            bench.set_peep(0.0);
            run(&mut bench, 0.0, true, 100);
            let start = bench.truth().alveolar_pressure;
            let time_constant_ms = resistance * compliance;
            let after = run(&mut bench, 0.0, true, time_constant_ms as u32).alveolar_pressure;
            let expected = (-1.0_f64).exp();
            assert!(
                (after / start - expected).abs() < 0.012,
                "R{resistance} C{compliance}: {}",
                after / start
            );
        }
    }

    #[test]
    fn circuit_takes_its_share_of_a_fast_rise() {
        // No gas enters a lung behind 1000 cmH2O/(L/s) within 30 ms: the circuit's compliance takes it all.
        let config = plain(1000.0, 20.0);
        let mut bench = bench(&config);
        let mut valve_ml = 0.0;
        while bench.truth().airway_pressure < 25.0 {
            bench.step(30.0, false);
            valve_ml += (bench.truth().flow_valve - bench.truth().flow_expiratory) * STEP_S * 1e3;
        }
        let rise = bench.truth().airway_pressure - f64::from(PEEP);
        assert!((valve_ml / rise / 1.5 - 1.0).abs() < 0.05, "{} mL/cmH2O", valve_ml / rise);
    }

    #[test]
    fn two_compartments_fill_at_their_own_pace() {
        let mut config = plain(5.0, 20.0);
        let slow = CompartmentConfig { resistance_cmh2o_per_l_s: 100.0, ..config.lung.first };
        config.lung.second = Some(slow);
        let mut bench = bench(&config);
        run(&mut bench, 40.0, false, 300);
        // With the valve closed, gas still moves from the fast compartment to the slow one, so the pressure falls.
        let shut = run(&mut bench, 0.0, false, 200);
        let settled = run(&mut bench, 0.0, false, 20_000);
        assert!(shut.airway_pressure - settled.airway_pressure > 1.0);
        assert!((settled.airway_pressure - settled.lung_volume_ml / 40.0).abs() < 1e-3);
    }
}

mod expiration {
    use super::*;

    #[test]
    fn returns_to_peep_and_holds_it_against_the_leak_with_a_bias_command() {
        for config in all_lungs() {
            let mut bench = bench(&config);
            run(&mut bench, 25.0, false, 500);
            run(&mut bench, BIAS, true, 12_000);
            for _ in 0..2_000 {
                bench.step(BIAS, true);
                let deviation = bench.truth().airway_pressure - f64::from(PEEP);
                assert!(deviation.abs() < 0.3, "{}: {deviation} cmH2O off PEEP", config.name);
            }
        }
    }

    #[test]
    fn the_bias_command_holds_peep_from_rest() {
        let truth = run(&mut bench(&BenchConfig::default()), BIAS, true, 10_000);
        assert!((truth.airway_pressure - f64::from(PEEP)).abs() < 0.3);
    }

    #[test]
    fn a_new_peep_setting_is_reached() {
        let mut bench = bench(&BenchConfig::default());
        bench.set_peep(10.0);
        let truth = run(&mut bench, 20.0, true, 4_000);
        assert!((truth.airway_pressure - 10.0).abs() < 0.5, "{}", truth.airway_pressure);
        bench.set_peep(f32::NAN);
        let truth = run(&mut bench, 20.0, true, 1_000);
        assert!((truth.airway_pressure - 10.0).abs() < 0.5, "not a number leaves the setting alone");
    }
}

mod limits {
    use super::*;

    #[test]
    fn relief_valve_limits_the_pressure_at_full_flow() {
        for config in all_lungs() {
            let mut bench = bench(&config);
            let mut highest = 0.0_f64;
            for _ in 0..4_000 {
                bench.step(100.0, false);
                highest = highest.max(bench.truth().airway_pressure);
            }
            assert!(highest > 69.0 && highest < 76.0, "{}: {highest} cmH2O", config.name);
        }
    }

    #[test]
    fn without_the_relief_valve_the_supply_pressure_is_the_limit() {
        let mut config = BenchConfig::from_name("R20C1").unwrap();
        config.circuit.relief_opening_cmh2o = 200.0;
        let truth = run(&mut bench(&config), 100.0, false, 5_000);
        assert!(truth.airway_pressure > 140.0 && truth.airway_pressure <= 150.0);
    }

    /// The bench cannot oscillate by itself: with constant valves the pressure turns at most twice (once for the
    /// circuit, once for the lung) before it settles.
    #[test]
    fn every_lung_is_stable_at_every_command() {
        let commands = [
            (5.0, true),
            (20.0, true),
            (8.0, false),
            (100.0, true),
            (100.0, false),
            (0.0, true),
            (BIAS, true),
        ];
        for config in all_lungs() {
            let mut bench = bench(&config);
            for (u_in, u_out) in commands {
                run(&mut bench, u_in, u_out, 400);
                let (mut last, mut rising, mut turns) = (bench.truth().airway_pressure, None, 0);
                for _ in 0..5_000 {
                    let pressure = run(&mut bench, u_in, u_out, 1).airway_pressure;
                    assert!((0.0..80.0).contains(&pressure), "{}: {pressure} cmH2O", config.name);
                    if (pressure - last).abs() > 1e-9 {
                        turns += u32::from(rising == Some(pressure < last));
                        rising = Some(pressure > last);
                    }
                    last = pressure;
                }
                assert!(turns <= 2, "{}: {turns} turns at {u_in} %, {u_out}", config.name);
            }
        }
    }

    #[test]
    fn four_sub_steps_are_enough() {
        for config in all_lungs() {
            let fine = BenchConfig { sub_steps: 64, ..config.clone() };
            let (mut coarse_bench, mut fine_bench) = (bench(&config), bench(&fine));
            let mut total = 0.0;
            for ms in 0..3_000 {
                let (u_in, u_out) = if ms < 600 { (30.0, false) } else { (BIAS, true) };
                coarse_bench.step(u_in, u_out);
                fine_bench.step(u_in, u_out);
                total += (coarse_bench.truth().airway_pressure - fine_bench.truth().airway_pressure).abs();
            }
            let mean = total / 3_000.0;
            assert!(mean < 0.05, "{}: {mean} cmH2O", config.name);
        }
    }
}
