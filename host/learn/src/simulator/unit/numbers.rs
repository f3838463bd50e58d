//! The numbers of a unit in the units of its data sheet.

use serde::{Deserialize, Serialize};

use super::{PER_UNIT, VALVE, lung, valve};

/// Numbers of a unit that its maker or user knows. Pressures alone do not tell the scale of the flow: full flow, R, C and leak are
/// those of a circuit with the usual compliance ([`super::spread::normalise`]). A circuit twice as compliant has twice the full flow,
/// C and leak, and half of R.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitNumbers {
    /// Dead time of the valve, ms.
    pub dead_time_ms: f32,
    /// Lag of the valve, ms.
    pub lag_ms: f32,
    /// Flow of the fully open valve, L/s.
    pub full_flow_l_per_s: f32,
    /// Resistance of the lung, cmH2O/(L/s).
    pub resistance_cmh2o_per_l_s: f32,
    /// Compliance of the lung, mL/cmH2O.
    pub compliance_ml_per_cmh2o: f32,
    /// Leak at 30 cmH2O, L/s.
    pub leak_l_per_s_at_30_cmh2o: f32,
}

impl UnitNumbers {
    /// The numbers of the first unit of a simulator's parameters.
    ///
    /// # Panics
    /// With fewer parameters than one unit has.
    pub fn of(parameters: &[f32]) -> Self {
        let number = |n: usize| parameters[..PER_UNIT][n].exp();
        Self {
            dead_time_ms: number(valve::DEAD_TIME),
            lag_ms: number(valve::LAG),
            full_flow_l_per_s: number(valve::FULL_FLOW),
            resistance_cmh2o_per_l_s: number(VALVE + lung::RESISTANCE),
            compliance_ml_per_cmh2o: number(VALVE + lung::COMPLIANCE),
            leak_l_per_s_at_30_cmh2o: number(VALVE + lung::LEAK),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::unit::UnitConfig;

    #[test]
    fn the_numbers_are_those_from_which_a_fit_starts() {
        let usual = UnitNumbers::of(&UnitConfig::for_period(1000, 2).initialise());
        let found = [
            usual.dead_time_ms,
            usual.lag_ms,
            usual.full_flow_l_per_s,
            usual.resistance_cmh2o_per_l_s,
            usual.compliance_ml_per_cmh2o,
            usual.leak_l_per_s_at_30_cmh2o,
        ];
        for (found, expected) in found.iter().zip([12.0, 25.0, 1.6, 20.0, 20.0, 0.02]) {
            assert!((found / expected - 1.0).abs() < 1e-5, "{found}, not {expected}");
        }
    }
}
