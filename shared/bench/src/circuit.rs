//! Breathing circuit: compliance of the tubing, leak, mechanical relief valve.

use super::branch::{Branch, parabolic_conductance};
use super::config::{CircuitConfig, LeakChange};
use crate::storage::{List, MOST_LEAK_CHANGES};

/// Pressure at which the leak is specified, cmH2O.
const LEAK_STATED_AT_CMH2O: f64 = 30.0;
/// Share of the leak's specified pressure that is lost in laminar flow; it keeps the leak's slope finite at zero.
const LEAK_LAMINAR_SHARE: f64 = 0.02;

/// The tubing and its state, the airway pressure.
#[derive(Clone, Debug)]
pub(super) struct Circuit {
    pressure: f64,
    /// Compliance over the duration of a sub-step, L/(s cmH2O).
    storage: f64,
    /// Pressure that a sub-step of the drawn flow takes from the compliance, cmH2O.
    drawn: f64,
    /// Leak at the specified pressure, L/s.
    leak: f64,
    /// The same without a failure.
    sound_leak: f64,
    /// Whether the leak is a failure's.
    failed: bool,
    /// Changes of the leak that are still to come, the next one last.
    leak_changes: List<LeakChange, MOST_LEAK_CHANGES>,
    relief_opening: f64,
    relief_conductance: f64,
}

impl Circuit {
    /// A circuit at rest at `pressure`.
    #[inline(never)]
    pub(super) fn new(config: &CircuitConfig, pressure: f64, sub_step_s: f64) -> Self {
        Self {
            pressure,
            storage: config.compliance_ml_per_cmh2o * 1e-3 / sub_step_s,
            drawn: 0.0,
            leak: config.leak_l_per_s_at_30_cmh2o,
            sound_leak: config.leak_l_per_s_at_30_cmh2o,
            failed: false,
            leak_changes: config.leak_changes.iter().rev().copied().collect(),
            relief_opening: config.relief_opening_cmh2o,
            relief_conductance: config.relief_conductance_l_per_s_per_cmh2o,
        }
    }

    pub(super) fn pressure(&self) -> f64 {
        self.pressure
    }

    /// The present leak at the specified pressure, L/s.
    pub(super) fn stated_leak(&self) -> f64 {
        self.leak
    }

    pub(super) fn set_pressure(&mut self, pressure: f64) {
        self.pressure = pressure;
    }

    /// Makes the circuit leak this flow to the room, L/s at 30 cmH2O, until it is repaired.
    pub(super) fn fail(&mut self, leak: f64) {
        (self.leak, self.failed) = (leak, true);
    }

    /// Returns to the leak that it would have now without a failure.
    pub(super) fn repair(&mut self) {
        (self.leak, self.failed) = (self.sound_leak, false);
    }

    /// Makes the changes of the leak that are due. A failure outlasts them.
    #[inline]
    pub(super) fn change_leak(&mut self, time_s: f64) {
        while self.leak_changes.last().is_some_and(|change| change.at_s <= time_s) {
            let Some(change) = self.leak_changes.pop() else { return };
            self.sound_leak = change.leak_l_per_s_at_30_cmh2o;
            if !self.failed {
                self.leak = self.sound_leak;
            }
        }
    }

    /// Draws this flow out of the circuit from now on, L/s.
    pub(super) fn draw(&mut self, flow: f64) {
        self.drawn = flow / self.storage;
    }

    /// The compliance as a branch to the present pressure, less what the drawn flow takes.
    pub(super) fn storage(&self) -> Branch {
        Branch { conductance: self.storage, source: self.pressure - self.drawn }
    }

    /// The leak as a branch to the room.
    pub(super) fn leak(&self) -> Branch {
        // A parabola through unit flow at the specified pressure; the leak scales it, down to zero.
        let linear = LEAK_LAMINAR_SHARE * LEAK_STATED_AT_CMH2O;
        let quadratic = (1.0 - LEAK_LAMINAR_SHARE) * LEAK_STATED_AT_CMH2O;
        let unit = parabolic_conductance(linear, quadratic, self.pressure);
        Branch { conductance: self.leak * unit, source: 0.0 }
    }

    /// The relief valve as a branch to its opening pressure; closed below.
    pub(super) fn relief(&self) -> Branch {
        let conductance = if self.pressure > self.relief_opening { self.relief_conductance } else { 0.0 };
        Branch { conductance, source: self.relief_opening }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SUB_STEP_S: f64 = 0.000_25;

    fn at(pressure: f64) -> Circuit {
        Circuit::new(&CircuitConfig::default(), pressure, SUB_STEP_S)
    }

    fn leak(pressure: f64) -> f64 {
        -at(pressure).leak().flow(pressure)
    }

    #[test]
    fn leak_is_an_orifice_with_the_stated_flow() {
        let stated = CircuitConfig::default().leak_l_per_s_at_30_cmh2o;
        assert!((leak(30.0) - stated).abs() < 1e-12);
        assert!((leak(7.5) / stated - 0.5).abs() < 0.02, "a quarter of the pressure, half the flow");
        assert!((leak(-30.0) + stated).abs() < 1e-12);
    }

    #[test]
    fn no_leak_means_no_flow() {
        let config = CircuitConfig { leak_l_per_s_at_30_cmh2o: 0.0, ..CircuitConfig::default() };
        for pressure in [0.0, 20.0] {
            let circuit = Circuit::new(&config, pressure, SUB_STEP_S);
            assert!(circuit.leak().flow(pressure).abs() < 1e-12);
        }
    }

    #[test]
    fn the_leak_changes_at_the_stated_times_and_a_failure_outlasts_the_changes() {
        let change = |at_s, leak_l_per_s_at_30_cmh2o| LeakChange { at_s, leak_l_per_s_at_30_cmh2o };
        let leak_changes = vec![change(1.0, 0.3), change(2.0, 0.1), change(3.0, 0.2)];
        let config = CircuitConfig { leak_changes, ..CircuitConfig::default() };
        let mut circuit = Circuit::new(&config, 30.0, SUB_STEP_S);
        let mut leak = |time_s, failure: fn(&mut Circuit)| {
            failure(&mut circuit);
            circuit.change_leak(time_s);
            -circuit.leak().flow(30.0)
        };
        let stated = CircuitConfig::default().leak_l_per_s_at_30_cmh2o;
        for (time_s, expected) in [(0.0, stated), (0.999, stated), (1.0, 0.3), (1.5, 0.3)] {
            assert!((leak(time_s, |_| ()) - expected).abs() < 1e-12, "{time_s} s");
        }
        assert!((leak(1.6, |circuit| circuit.fail(20.0)) - 20.0).abs() < 1e-9);
        assert!((leak(2.5, |_| ()) - 20.0).abs() < 1e-9);
        assert!((leak(2.6, Circuit::repair) - 0.1).abs() < 1e-12);
        assert!((leak(9.0, |_| ()) - 0.2).abs() < 1e-12);
    }

    #[test]
    fn relief_valve_opens_at_its_pressure() {
        let flow = |pressure| -at(pressure).relief().flow(pressure);
        assert!(flow(69.9).abs() < 1e-12);
        let expected = CircuitConfig::default().relief_conductance_l_per_s_per_cmh2o;
        assert!((flow(72.0) - 2.0 * expected).abs() < 1e-9);
    }

    #[test]
    fn storage_takes_the_compliance_in_millilitres() {
        let circuit = at(10.0);
        let volume_ml = -circuit.storage().flow(12.0) * SUB_STEP_S * 1e3;
        assert!((volume_ml - 2.0 * 1.5).abs() < 1e-9);
    }
}
