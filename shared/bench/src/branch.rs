//! Branches of the pneumatic circuit and the implicit solution for the pressure at their junction.
//!
//! Every branch is written as `flow = conductance * (source - pressure)`: the conductance comes from the state before
//! the sub-step, the pressure from after it. The result is a mean of pressures with positive weights, so it cannot
//! overshoot or oscillate however stiff a branch is. The same flows move the volumes, so that no gas is lost. The
//! square root near PEEP needs no special case.

use crate::math::sqrt;

/// Conductance in L/(s cmH2O) at the pressure difference `difference`, in cmH2O, of a branch that obeys
/// `difference = linear * flow + quadratic * flow * |flow|`.
///
/// The linear part keeps it finite where an ideal orifice has infinite slope.
#[inline]
pub(super) fn parabolic_conductance(linear: f64, quadratic: f64, difference: f64) -> f64 {
    2.0 / (linear + sqrt(linear * linear + 4.0 * quadratic * difference.abs()))
}

/// One branch during one sub-step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Branch {
    /// L/(s cmH2O).
    pub(super) conductance: f64,
    /// Pressure at the far end, cmH2O.
    pub(super) source: f64,
}

impl Branch {
    /// Flow into the junction in L/s while the junction is at `pressure`.
    pub(super) fn flow(&self, pressure: f64) -> f64 {
        self.conductance * (self.source - pressure)
    }
}

/// The branches that meet at the airway opening.
#[derive(Clone, Copy, Debug)]
pub(super) struct Junction {
    /// The compliance of the circuit, as a branch to the pressure before the sub-step.
    pub(super) storage: Branch,
    /// Inspiratory valve: inflow only.
    pub(super) valve: Branch,
    /// Expiratory valve: outflow only.
    pub(super) expiratory: Branch,
    /// Relief valve: outflow only.
    pub(super) relief: Branch,
    /// Leak, to the room.
    pub(super) leak: Branch,
    /// The one or two compartments of the lung.
    pub(super) lung: [Branch; 2],
}

impl Junction {
    /// Pressure after the sub-step, in cmH2O, at which all flows sum to zero. A one-way branch that would carry flow
    /// backwards is closed.
    #[inline]
    pub(super) fn solve(&mut self) -> f64 {
        let mut pressure = self.balance();
        if self.valve.flow(pressure) < 0.0 {
            self.valve.conductance = 0.0;
            pressure = self.balance();
        }
        if self.relief.flow(pressure) > 0.0 {
            self.relief.conductance = 0.0;
            pressure = self.balance();
        }
        if self.expiratory.flow(pressure) > 0.0 {
            self.expiratory.conductance = 0.0;
            pressure = self.balance();
        }
        pressure
    }

    #[inline]
    fn balance(&self) -> f64 {
        let Self { storage, valve, expiratory, relief, leak, lung: [first, second] } = self;
        // In pairs, so that the processor can start one sum before the other is complete.
        let total = |value: fn(&Branch) -> f64| {
            let valves = (value(valve) + value(expiratory)) + (value(relief) + value(leak));
            valves + (value(storage) + (value(first) + value(second)))
        };
        total(|branch| branch.conductance * branch.source) / total(|branch| branch.conductance)
    }
}

#[cfg(test)]
mod tests {
    use super::{Branch, Junction, parabolic_conductance};

    fn junction() -> Junction {
        let branch = |conductance, source| Branch { conductance, source };
        Junction {
            storage: branch(6.0, 20.0),
            valve: branch(0.01, 150.0),
            expiratory: branch(0.5, 5.0),
            relief: branch(0.0, 70.0),
            leak: branch(0.001, 0.0),
            lung: [branch(0.05, 15.0), branch(0.02, 10.0)],
        }
    }

    fn sum_of_flows(j: &Junction, pressure: f64) -> f64 {
        [j.storage, j.valve, j.expiratory, j.relief, j.leak, j.lung[0], j.lung[1]]
            .iter()
            .map(|branch| branch.flow(pressure))
            .sum()
    }

    #[test]
    fn conductance_inverts_the_parabola() {
        for flow in [0.001_f64, 0.1, 1.0, 3.0] {
            let difference = 4.0 * flow + 7.0 * flow * flow;
            let found = parabolic_conductance(4.0, 7.0, difference) * difference;
            assert!((found - flow).abs() < 1e-12, "{found} {flow}");
            let backwards = parabolic_conductance(4.0, 7.0, -difference) * -difference;
            assert!((backwards + flow).abs() < 1e-12);
        }
    }

    #[test]
    fn conductance_is_finite_at_no_difference() {
        assert!((parabolic_conductance(0.5, 3.0, 0.0) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn flows_add_up_to_zero() {
        let mut j = junction();
        let pressure = j.solve();
        assert!(sum_of_flows(&j, pressure).abs() < 1e-12);
    }

    #[test]
    fn one_way_branches_never_carry_flow_backwards() {
        let mut j = junction();
        // A patient who inhales strongly takes the circuit below PEEP: no gas may return through the PEEP valve.
        j.lung[0] = Branch { conductance: 10.0, source: -40.0 };
        let pressure = j.solve();
        assert!(pressure < 5.0);
        assert!(j.expiratory.flow(pressure).abs() < 1e-12);
        assert!(sum_of_flows(&j, pressure).abs() < 1e-9);

        let mut j = junction();
        // A cough above the supply pressure.
        j.storage.source = 149.0;
        j.relief.conductance = 0.3;
        j.lung[0] = Branch { conductance: 1000.0, source: 400.0 };
        let pressure = j.solve();
        assert!(pressure > 150.0);
        assert!(j.valve.flow(pressure).abs() < 1e-12);
        assert!(j.relief.flow(pressure) < 0.0, "the relief valve does open");

        let mut j = junction();
        // The relief valve was open before the sub-step, and the lung empties the circuit within it.
        j.storage.source = 70.1;
        j.relief.conductance = 0.3;
        let pressure = j.solve();
        assert!(pressure < 70.0);
        assert!(j.relief.flow(pressure).abs() < 1e-12);
    }
}
