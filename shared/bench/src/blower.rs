//! Blower: the gas supply of a machine without compressed gas. Its pressure falls with the flow, at once along the blower's curve and,
//! while the rotor slows under the load, with the rotor's inertia.
//!
//! ```text
//! supply = P0 n^2 - b q^2            P0: pressure without flow at the set speed; n: speed as a share of the set one
//! T dn/dt = 1 - n - s q              T: inertia of the rotor against its speed controller; s: what that leaves of the load
//! ```
//!
//! The form and the usual values come from records of the `MakAir` ventilator: see [`BlowerConfig`].

use super::config::BlowerConfig;
use super::lag::Lag;

/// The blower and its state.
#[derive(Clone, Debug)]
pub(super) struct Blower {
    shut_off: f64,
    drop: f64,
    /// Share of the set speed that is lost per flow, s/L.
    sag: f64,
    /// Set speed as a share of that with the stated pressure without flow.
    set: f64,
    /// Speed as a share of the same.
    speed: Lag,
}

impl Blower {
    /// A blower at its set speed, with this pressure without flow, cmH2O.
    pub(super) fn new(config: &BlowerConfig, shut_off: f64, sub_step_s: f64) -> Self {
        Self {
            shut_off,
            drop: config.drop_cmh2o_per_l2_s2,
            sag: config.sag_percent_per_l_per_s / 100.0,
            set: 1.0,
            speed: Lag::new(config.speed_lag_ms * 1e-3, sub_step_s, 1.0),
        }
    }

    /// Moves the rotor by one sub-step under the load of this flow, L/s.
    pub(super) fn advance(&mut self, flow: f64) {
        self.speed.advance((self.set - self.sag * flow).max(0.0));
    }

    /// Sets another speed, as a share of the one with the stated pressure; the rotor follows. Only records of machines change it.
    #[cfg(test)]
    pub(super) fn set_speed(&mut self, share: f64) {
        self.set = share;
    }

    /// Pressure without flow at the present speed, cmH2O: it grows with the square of the speed.
    pub(super) fn source(&self) -> f64 {
        self.shut_off * self.speed.output() * self.speed.output()
    }

    /// Loss of pressure per square of the flow, cmH2O/(L/s)^2.
    pub(super) fn drop(&self) -> f64 {
        self.drop
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{BIAS, run};
    use crate::{Bench, BenchConfig, STEP_S};

    const SUB_STEP_S: f64 = 0.000_25;
    const SHUT_OFF: f64 = 60.0;

    fn blower(config: &BlowerConfig) -> Blower {
        Blower::new(config, SHUT_OFF, SUB_STEP_S)
    }

    fn sagging() -> BlowerConfig {
        BlowerConfig { sag_percent_per_l_per_s: 10.0, ..BlowerConfig::default() }
    }

    /// The default machine on a blower, without leak and relief.
    fn machine(config: BlowerConfig) -> BenchConfig {
        let mut bench = BenchConfig { blower: Some(config), ..BenchConfig::default() };
        bench.valve.supply_pressure_cmh2o = SHUT_OFF;
        bench.valve.max_flow_l_per_s = 4.0;
        bench.circuit.leak_l_per_s_at_30_cmh2o = 0.0;
        bench
    }

    fn bench(config: &BenchConfig) -> Bench {
        Bench::new(config, 5.0, 1).unwrap()
    }

    #[test]
    fn without_flow_it_holds_its_pressure() {
        let mut blower = blower(&sagging());
        for _ in 0..10_000 {
            blower.advance(0.0);
        }
        assert!((blower.source() - SHUT_OFF).abs() < 1e-12);
        // A closed lung ends at the same pressure.
        let truth = run(&mut bench(&machine(sagging())), 100.0, false, 30_000);
        assert!((truth.airway_pressure - SHUT_OFF).abs() < 0.1, "{}", truth.airway_pressure);
    }

    #[test]
    fn the_flow_of_the_open_valve_is_that_of_the_curve() {
        let config = BlowerConfig { sag_percent_per_l_per_s: 0.0, ..BlowerConfig::default() };
        let mut open_end = machine(config);
        open_end.circuit.leak_l_per_s_at_30_cmh2o = 1.0;
        open_end.valve.backlash_percent = 0.0;
        let truth = run(&mut bench(&open_end), 100.0, false, 20_000);
        let resistance = config.drop_cmh2o_per_l2_s2 + SHUT_OFF / 16.0;
        let lost = resistance * truth.flow_valve.powi(2) + 0.3 * truth.flow_valve;
        assert!(truth.flow_valve > 0.5);
        assert!((SHUT_OFF - lost - truth.airway_pressure).abs() < 0.01, "{truth:?}");
    }

    #[test]
    fn the_rotor_slows_under_a_load_with_its_inertia_and_recovers() {
        let mut blower = blower(&sagging());
        let mut after = |flow: f64, ms: u32| {
            for _ in 0..4 * ms {
                blower.advance(flow);
            }
            (blower.source() / SHUT_OFF).sqrt()
        };
        let lag_ms = sagging().speed_lag_ms as u32;
        let one_lag = 1.0 - (-1.0_f64).exp();
        assert!((after(1.0, lag_ms) - (1.0 - 0.1 * one_lag)).abs() < 1e-9);
        assert!((after(1.0, 20 * lag_ms) - 0.9).abs() < 1e-6, "the speed controller has a finite gain");
        assert!((after(0.0, 20 * lag_ms) - 1.0).abs() < 1e-6);
        assert!(after(50.0, 20 * lag_ms) < 1e-6, "a load never turns the rotor backwards");
    }

    #[test]
    fn the_full_flow_of_a_machine_is_the_steady_one_that_its_open_valve_reaches() {
        let machine = machine(sagging());
        let full = machine.full_flow_l_per_s();
        let mut blower = blower(&sagging());
        let mut flow = 0.0;
        for _ in 0..200_000 {
            flow = (blower.source() / (blower.drop() + SHUT_OFF / 16.0)).sqrt();
            blower.advance(flow);
        }
        assert!((flow - full).abs() < 1e-6 && full < 1.5, "{flow}, not {full}");
        let alone = BenchConfig { blower: None, ..machine };
        assert!((alone.full_flow_l_per_s() - 4.0).abs() < 1e-12);
    }

    #[test]
    fn gas_never_flows_back_into_the_blower() {
        let mut config = machine(BlowerConfig::default());
        config.patient.cough_cmh2o = 150.0;
        config.patient.cough_at_s = 0.3;
        config.circuit.relief_opening_cmh2o = 200.0;
        let mut bench = bench(&config);
        let mut highest = 0.0_f64;
        for _ in 0..1_500 {
            bench.step(100.0, false);
            highest = highest.max(bench.truth().airway_pressure);
            assert!(bench.truth().flow_valve >= 0.0);
        }
        assert!(highest > SHUT_OFF, "the cough exceeds the blower's pressure: {highest}");
    }

    /// What the circuit receives is less than what a blower at its full pressure would give with the same flow, and more than nothing.
    #[test]
    fn energy_is_lost_between_blower_and_circuit_and_none_is_made() {
        let mut bench = bench(&machine(sagging()));
        let (mut given, mut received) = (0.0, 0.0);
        for ms in 0..4_000 {
            bench.step(if ms % 1_000 < 400 { 60.0 } else { BIAS }, ms % 1_000 >= 400);
            let truth = bench.truth();
            given += truth.flow_valve * SHUT_OFF * STEP_S;
            received += truth.flow_valve * truth.airway_pressure * STEP_S;
            assert!(truth.airway_pressure < SHUT_OFF);
        }
        assert!(received > 0.1 * given && received < 0.9 * given, "{received} of {given}");
    }

    #[test]
    fn a_stiff_blower_is_a_gas_supply_and_without_one_nothing_changes() {
        let stiff =
            BlowerConfig { drop_cmh2o_per_l2_s2: 0.0, sag_percent_per_l_per_s: 0.0, speed_lag_ms: 300.0 };
        let with = machine(stiff);
        let without = BenchConfig { blower: None, ..with.clone() };
        assert!(!without.to_toml().contains("blower") && !without.to_toml().contains("peep_band"));
        let (mut with, mut without) = (bench(&with), bench(&without));
        for ms in 0..2_000_u32 {
            let (u_in, u_out) = if ms % 1_000 < 600 { (30.0, false) } else { (BIAS, true) };
            with.step(u_in, u_out);
            without.step(u_in, u_out);
            let apart = with.airway_pressure() - without.airway_pressure();
            assert!(apart.abs() < 0.3, "{apart} at {ms} ms");
        }
    }
}
