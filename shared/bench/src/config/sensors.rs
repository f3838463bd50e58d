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

/// Second pressure sensor, at the machine's outlet: the airway pressure plus the drop along the inspiratory tube.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutletSensorConfig {
    /// Whether the machine has this sensor.
    pub present: bool,
    /// Time constant, ms.
    pub lag_ms: f64,
    /// Standard deviation of the Gaussian noise on each sample, cmH2O.
    pub noise_sd_cmh2o: f64,
    /// Step of the 12-bit converter, cmH2O; 0 for a converter without steps and limits.
    pub quantum_cmh2o: f64,
    /// Offset at the start, cmH2O.
    pub offset_cmh2o: f64,
    /// Drift of the offset, cmH2O/h.
    pub drift_cmh2o_per_hour: f64,
    /// Resistance of the tube between outlet and airway, cmH2O/(L/s). The sensor reads it; the valve does not feel it.
    pub tube_resistance_cmh2o_per_l_s: f64,
}

impl Default for OutletSensorConfig {
    fn default() -> Self {
        let SensorConfig { lag_ms, noise_sd_cmh2o, quantum_cmh2o } = SensorConfig::default();
        Self {
            present: true,
            lag_ms,
            noise_sd_cmh2o,
            quantum_cmh2o,
            offset_cmh2o: 0.0,
            drift_cmh2o_per_hour: 0.0,
            tube_resistance_cmh2o_per_l_s: 3.0,
        }
    }
}

/// Bidirectional flow sensor at the airway opening: flow into lung and leak, positive towards the patient.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlowSensorConfig {
    /// Whether the machine has this sensor.
    pub present: bool,
    /// Time constant, ms.
    pub lag_ms: f64,
    /// Standard deviation of the Gaussian noise on each sample, L/s.
    pub noise_sd_l_per_s: f64,
    /// Offset, L/s.
    pub offset_l_per_s: f64,
    /// Error of the gain, percent of the flow.
    pub gain_error_percent: f64,
}

impl Default for FlowSensorConfig {
    fn default() -> Self {
        Self {
            present: true,
            lag_ms: 2.0,
            noise_sd_l_per_s: 0.005,
            offset_l_per_s: 0.0,
            gain_error_percent: 0.0,
        }
    }
}

impl SensorConfig {
    pub(super) fn validate(&self, table: &str) -> Result<(), BenchError> {
        let check = |field: &str, value, range| check(format_args!("{table}.{field}"), value, range);
        check("lag_ms", self.lag_ms, 0.0..=100.0)?;
        check("noise_sd_cmh2o", self.noise_sd_cmh2o, 0.0..=5.0)?;
        check("quantum_cmh2o", self.quantum_cmh2o, 0.0..=2.0)
    }
}

impl OutletSensorConfig {
    /// What it shares with the sensor at the airway opening.
    pub(crate) fn sensor(&self) -> SensorConfig {
        let Self { lag_ms, noise_sd_cmh2o, quantum_cmh2o, .. } = *self;
        SensorConfig { lag_ms, noise_sd_cmh2o, quantum_cmh2o }
    }

    pub(super) fn validate(&self) -> Result<(), BenchError> {
        self.sensor().validate("outlet_sensor")?;
        check("outlet_sensor.offset_cmh2o", self.offset_cmh2o, -20.0..=20.0)?;
        check("outlet_sensor.drift_cmh2o_per_hour", self.drift_cmh2o_per_hour, -10.0..=10.0)?;
        let resistance = self.tube_resistance_cmh2o_per_l_s;
        check("outlet_sensor.tube_resistance_cmh2o_per_l_s", resistance, 0.0..=100.0)
    }
}

impl FlowSensorConfig {
    pub(super) fn validate(&self) -> Result<(), BenchError> {
        check("flow_sensor.lag_ms", self.lag_ms, 0.0..=100.0)?;
        check("flow_sensor.noise_sd_l_per_s", self.noise_sd_l_per_s, 0.0..=1.0)?;
        check("flow_sensor.offset_l_per_s", self.offset_l_per_s, -2.0..=2.0)?;
        check("flow_sensor.gain_error_percent", self.gain_error_percent, -50.0..=50.0)
    }
}
