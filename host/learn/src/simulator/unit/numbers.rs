//! The numbers of a unit in the units of its data sheet.

use serde::{Deserialize, Serialize};

use super::{PER_UNIT, USUAL, VALVE, lung, valve};
use engine::Lane;

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

/// Flow of the valve of the first unit of a simulator's parameters at a quarter, half, three quarters and all of its command, L/s, at the
/// scale of [`UnitNumbers`].
///
/// # Panics
/// With fewer parameters than one unit has.
pub fn valve_flows(parameters: &[f32]) -> [f32; 4] {
    let number = |n: usize| Lane::splat(parameters[..PER_UNIT][n].exp());
    let [zone, exponent, full] = [valve::ZONE, valve::EXPONENT, valve::FULL_FLOW].map(number);
    [25.0, 50.0, 75.0, 100.0].map(|command| (full * valve::opening(Lane::splat(command), zone, exponent))[0])
}

/// Numbers of a machine, which come first among those of [`scaled`].
pub const MACHINE_NUMBERS: usize = 6;
/// Numbers of machine and lung.
pub const UNIT_NUMBERS: usize = MACHINE_NUMBERS + 2;
/// Logarithm of a number's ratio to the usual one that is scaled to one.
const SCALE: f32 = 0.5;

/// Dead time, lag, play, dead zone, exponent and full flow of one unit's machine, and R and C of one unit's lung, as scaled logarithms
/// of their ratios to the usual ones.
///
/// # Panics
/// With a unit that the parameters do not have.
pub fn scaled(parameters: &[f32], machine: Option<u32>, lung: Option<u32>) -> [f32; UNIT_NUMBERS] {
    let [own, lungs] = [machine, lung].map(|unit| unit.map_or(0, |unit| unit as usize) * PER_UNIT);
    let places = [
        own + valve::DEAD_TIME,
        own + valve::LAG,
        own + valve::PLAY,
        own + valve::ZONE,
        own + valve::EXPONENT,
        own + valve::FULL_FLOW,
        lungs + VALVE + lung::RESISTANCE,
        lungs + VALVE + lung::COMPLIANCE,
    ];
    places.map(|place| (parameters[place] - USUAL[place % PER_UNIT].ln()) / SCALE)
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

    #[test]
    fn the_scaled_numbers_are_those_of_one_units_machine_and_of_anothers_lung() {
        let mut parameters = UnitConfig::for_period(1000, 2).initialise();
        let near = |found: [f32; UNIT_NUMBERS], machine: f32, lung: f32| {
            let (machines, lungs) = found.split_at(MACHINE_NUMBERS);
            machines.iter().all(|number| (number - machine).abs() < 1e-5)
                && lungs.iter().all(|number| (number - lung).abs() < 1e-5)
        };
        assert!(near(scaled(&parameters, Some(0), Some(1)), 0.0, 0.0));
        parameters[PER_UNIT..].iter_mut().for_each(|parameter| *parameter += SCALE);
        assert!(near(scaled(&parameters, Some(0), Some(1)), 0.0, 1.0));
        assert!(near(scaled(&parameters, Some(1), Some(0)), 1.0, 0.0));
    }

    #[test]
    fn the_flow_of_the_valve_rises_to_the_full_flow() {
        let flows = valve_flows(&UnitConfig::for_period(1000, 1).initialise());
        assert!(flows.windows(2).all(|pair| pair[0] < pair[1]), "{flows:?}");
        // The usual valve: 4 % dead zone, exponent 1.3, 1.6 L/s.
        for (flow, expected) in flows.iter().zip([21.0_f32, 46.0, 71.0, 96.0]) {
            assert!((flow - 1.6 * (expected / 96.0).powf(1.3)).abs() < 1e-4, "{flows:?}");
        }
    }
}
