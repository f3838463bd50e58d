//! Parameters of a blower.

use serde::{Deserialize, Serialize};

use super::{BenchError, check};

/// Blower in place of a gas supply of constant pressure. Its pressure without flow is the valve's `supply_pressure_cmh2o`.
///
/// The defaults lie amid what a model of this form needs to follow records of the `MakAir` ventilator
/// (<https://github.com/makers-for-life/makair-telemetry>, public domain) from their commands. The set speed changes in them between
/// breaths only: they show the lag, and no sag within a breath.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BlowerConfig {
    /// Loss of pressure per square of the flow at constant speed, cmH2O/(L/s)^2.
    pub drop_cmh2o_per_l2_s2: f64,
    /// Speed that the load of a flow takes in the end, percent of the set speed per L/s: the speed controller has a finite gain.
    pub sag_percent_per_l_per_s: f64,
    /// Time constant of the speed, ms: inertia of the rotor against its speed controller.
    pub speed_lag_ms: f64,
}

impl Default for BlowerConfig {
    fn default() -> Self {
        Self { drop_cmh2o_per_l2_s2: 25.0, sag_percent_per_l_per_s: 3.0, speed_lag_ms: 300.0 }
    }
}

impl BlowerConfig {
    pub(super) fn validate(&self) -> Result<(), BenchError> {
        check("blower.drop_cmh2o_per_l2_s2", self.drop_cmh2o_per_l2_s2, 0.0..=500.0)?;
        check("blower.sag_percent_per_l_per_s", self.sag_percent_per_l_per_s, 0.0..=50.0)?;
        check("blower.speed_lag_ms", self.speed_lag_ms, 1.0..=5000.0)
    }
}
