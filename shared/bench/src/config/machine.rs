//! Parameters of the machine: valves, circuit, spread between units.

use core::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::{BenchError, check};
use crate::storage::{List, MOST_LEAK_CHANGES};

/// Inspiratory proportional valve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ValveConfig {
    /// Time in which a command has no effect, ms; resolved to a sub-step.
    pub dead_time_ms: f64,
    /// Time constant of the actuator, ms.
    pub lag_ms: f64,
    /// Backlash between actuator and stem, percent of the full command.
    pub backlash_percent: f64,
    /// Travel without flow, percent of the full command.
    pub dead_zone_percent: f64,
    /// Exponent of flow over travel beyond the dead zone.
    pub curve_exponent: f64,
    /// Flow at 100 % against the pressure of the room, L/s.
    pub max_flow_l_per_s: f64,
    /// Supply pressure, cmH2O: the flow falls with the square root of its difference to the circuit's pressure. With a blower, the
    /// pressure that it holds without flow.
    pub supply_pressure_cmh2o: f64,
}

impl Default for ValveConfig {
    fn default() -> Self {
        Self {
            dead_time_ms: 12.0,
            lag_ms: 25.0,
            backlash_percent: 4.0,
            dead_zone_percent: 4.0,
            curve_exponent: 1.3,
            max_flow_l_per_s: 1.67,
            supply_pressure_cmh2o: 150.0,
        }
    }
}

/// Expiratory on/off valve with a mechanical PEEP valve behind it, or proportional valve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExpiratoryConfig {
    /// Time constant of opening and closing, ms.
    pub lag_ms: f64,
    /// Flow per root of the pressure above PEEP, L/s per sqrt(cmH2O).
    pub orifice_l_per_s_per_sqrt_cmh2o: f64,
    /// Resistance at small flow, cmH2O/(L/s).
    pub laminar_resistance_cmh2o_per_l_s: f64,
    /// Pressure below PEEP at which a proportional valve has closed, cmH2O: it holds PEEP by closing partly, with this finite gain.
    /// Absent: an on/off valve with a mechanical PEEP valve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peep_band_cmh2o: Option<f64>,
}

impl Default for ExpiratoryConfig {
    fn default() -> Self {
        Self {
            lag_ms: 15.0,
            orifice_l_per_s_per_sqrt_cmh2o: 0.4,
            laminar_resistance_cmh2o_per_l_s: 0.5,
            peep_band_cmh2o: None,
        }
    }
}

/// Breathing circuit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CircuitConfig {
    /// Compliance of the tubing, mL/cmH2O.
    pub compliance_ml_per_cmh2o: f64,
    /// Leak to the room at 30 cmH2O, L/s.
    pub leak_l_per_s_at_30_cmh2o: f64,
    /// Opening pressure of the relief valve, cmH2O.
    pub relief_opening_cmh2o: f64,
    /// Flow of the relief valve per pressure above its opening, (L/s)/cmH2O.
    pub relief_conductance_l_per_s_per_cmh2o: f64,
    /// Leaks that replace `leak_l_per_s_at_30_cmh2o` later, in the order of their times.
    pub leak_changes: List<LeakChange, MOST_LEAK_CHANGES>,
}

impl Default for CircuitConfig {
    fn default() -> Self {
        Self {
            compliance_ml_per_cmh2o: 1.5,
            leak_l_per_s_at_30_cmh2o: 0.005,
            relief_opening_cmh2o: 70.0,
            relief_conductance_l_per_s_per_cmh2o: 0.3,
            leak_changes: List::new(),
        }
    }
}

/// A leak from this time on. Both fields are required.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeakChange {
    /// Time since the start of the simulation, s.
    pub at_s: f64,
    /// Leak to the room at 30 cmH2O, L/s.
    pub leak_l_per_s_at_30_cmh2o: f64,
}

/// The unit of the machine type, and the spread between units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UnitConfig {
    /// Number of the unit; 0 is the nominal unit without deviation.
    pub number: u32,
    /// Spread of the flow of the inspiratory valve, percent (sd).
    pub flow_gain_sd_percent: f64,
    /// Spread of the sensor offset, cmH2O (sd).
    pub sensor_offset_sd_cmh2o: f64,
    /// Spread of the valve's dead time, ms (sd).
    pub dead_time_sd_ms: f64,
    /// Drift of the sensor offset, cmH2O/h; it applies to unit 0 too.
    pub sensor_drift_cmh2o_per_hour: f64,
}

impl Default for UnitConfig {
    fn default() -> Self {
        Self {
            number: 0,
            flow_gain_sd_percent: 5.0,
            sensor_offset_sd_cmh2o: 0.3,
            dead_time_sd_ms: 1.0,
            sensor_drift_cmh2o_per_hour: 0.0,
        }
    }
}

impl ValveConfig {
    pub(super) fn validate(&self) -> Result<(), BenchError> {
        check("valve.dead_time_ms", self.dead_time_ms, 0.0..=100.0)?;
        check("valve.lag_ms", self.lag_ms, 0.0..=500.0)?;
        check("valve.backlash_percent", self.backlash_percent, 0.0..=20.0)?;
        check("valve.dead_zone_percent", self.dead_zone_percent, 0.0..=50.0)?;
        check("valve.curve_exponent", self.curve_exponent, 0.5..=4.0)?;
        check("valve.max_flow_l_per_s", self.max_flow_l_per_s, 0.05..=5.0)?;
        check("valve.supply_pressure_cmh2o", self.supply_pressure_cmh2o, 50.0..=5000.0)
    }
}

impl ExpiratoryConfig {
    pub(super) fn validate(&self) -> Result<(), BenchError> {
        let check = |field: &str, value, range| check(format_args!("expiratory.{field}"), value, range);
        check("lag_ms", self.lag_ms, 0.0..=500.0)?;
        check("orifice_l_per_s_per_sqrt_cmh2o", self.orifice_l_per_s_per_sqrt_cmh2o, 0.02..=5.0)?;
        check("laminar_resistance_cmh2o_per_l_s", self.laminar_resistance_cmh2o_per_l_s, 0.01..=50.0)?;
        self.peep_band_cmh2o.map_or(Ok(()), |band| check("peep_band_cmh2o", band, 0.2..=20.0))
    }
}

/// Allowed leaks, L/s at 30 cmH2O.
const LEAKS: RangeInclusive<f64> = 0.0..=1.0;

impl CircuitConfig {
    pub(super) fn validate(&self) -> Result<(), BenchError> {
        let check = |field: &str, value, range| check(format_args!("circuit.{field}"), value, range);
        check("compliance_ml_per_cmh2o", self.compliance_ml_per_cmh2o, 0.1..=20.0)?;
        check("leak_l_per_s_at_30_cmh2o", self.leak_l_per_s_at_30_cmh2o, LEAKS)?;
        check("relief_opening_cmh2o", self.relief_opening_cmh2o, 20.0..=200.0)?;
        check(
            "relief_conductance_l_per_s_per_cmh2o",
            self.relief_conductance_l_per_s_per_cmh2o,
            0.01..=10.0,
        )?;
        for (place, change) in self.leak_changes.iter().enumerate() {
            let check = |field: &str, value, range| {
                super::check(format_args!("circuit.leak_changes[{place}].{field}"), value, range)
            };
            check("at_s", change.at_s, 0.0..=1e6)?;
            let leak = change.leak_l_per_s_at_30_cmh2o;
            check("leak_l_per_s_at_30_cmh2o", leak, LEAKS)?;
        }
        let mut pairs = self.leak_changes.windows(2).enumerate();
        match pairs.find(|(_, pair)| pair[1].at_s <= pair[0].at_s) {
            Some((place, pair)) => {
                Err(BenchError::LeakOrder { place: place + 1, at_s: pair[1].at_s, before_s: pair[0].at_s })
            }
            None => Ok(()),
        }
    }
}

impl UnitConfig {
    pub(super) fn validate(&self) -> Result<(), BenchError> {
        check("unit.flow_gain_sd_percent", self.flow_gain_sd_percent, 0.0..=20.0)?;
        check("unit.sensor_offset_sd_cmh2o", self.sensor_offset_sd_cmh2o, 0.0..=5.0)?;
        check("unit.dead_time_sd_ms", self.dead_time_sd_ms, 0.0..=5.0)?;
        check("unit.sensor_drift_cmh2o_per_hour", self.sensor_drift_cmh2o_per_hour, -10.0..=10.0)
    }
}
