//! Parameters of the sensors.

use serde::{Deserialize, Serialize};

use super::{BenchError, check};

/// Pressure sensor at the airway opening.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConfig {
    /// Time constant, ms.
    pub lag_ms: f64,
    /// Standard deviation of the Gaussian noise on each sample, cmH2O.
    pub noise_sd_cmh2o: f64,
    /// Step of the 12-bit converter, cmH2O; 0 for a converter without steps and limits.
    pub quantum_cmh2o: f64,
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self { lag_ms: 4.0, noise_sd_cmh2o: 0.1, quantum_cmh2o: 0.07 }
    }
}

impl SensorConfig {
    pub(super) fn validate(&self, table: &str) -> Result<(), BenchError> {
        let check = |field: &str, value, range| check(&format!("{table}.{field}"), value, range);
        check("lag_ms", self.lag_ms, 0.0..=100.0)?;
        check("noise_sd_cmh2o", self.noise_sd_cmh2o, 0.0..=5.0)?;
        check("quantum_cmh2o", self.quantum_cmh2o, 0.0..=2.0)
    }
}
