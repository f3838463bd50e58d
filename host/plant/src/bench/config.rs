//! Parameters of the virtual bench: defaults, allowed ranges, TOML.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::STEP_US;

/// Allowed settings of the mechanical PEEP valve, cmH2O.
pub const PEEP_RANGE_CMH2O: RangeInclusive<f64> = 0.0..=50.0;

/// Why a bench was refused.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// A value is not finite or outside its range.
    #[error("{field} = {value} is outside {low} to {high}: set it within that range")]
    OutOfRange {
        /// Path of the field, as in the TOML file.
        field: String,
        /// The value found.
        value: f64,
        /// Lowest allowed value.
        low: f64,
        /// Highest allowed value.
        high: f64,
    },
    /// The control period is not a multiple of the bench's step.
    #[error("the control period must be a multiple of the bench's step of {STEP_US} us, not {period_us} us")]
    Period {
        /// Requested control period, microseconds.
        period_us: u32,
    },
    /// There is no lung or preset of that name.
    #[error(
        "unknown lung \"{0}\": use R<cmH2O/(L/s)>C<mL/cmH2O> (such as R20C20), iso-01 to iso-21, \
         or for several lungs paper or iso"
    )]
    UnknownName(String),
    /// The file is not a bench description.
    #[error("the bench description is not valid: {0}")]
    Syntax(#[from] toml::de::Error),
    /// The file cannot be read.
    #[error("cannot read the bench description {}: {source}; check the path", path.display())]
    File {
        /// The path tried.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

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
    /// Supply pressure, cmH2O: the flow falls with the square root of its difference to the circuit's pressure.
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

/// Expiratory on/off valve with a mechanical PEEP valve behind it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExpiratoryConfig {
    /// Time constant of opening and closing, ms.
    pub lag_ms: f64,
    /// Flow per root of the pressure above PEEP, L/s per sqrt(cmH2O).
    pub orifice_l_per_s_per_sqrt_cmh2o: f64,
    /// Resistance at small flow, cmH2O/(L/s).
    pub laminar_resistance_cmh2o_per_l_s: f64,
}

impl Default for ExpiratoryConfig {
    fn default() -> Self {
        Self { lag_ms: 15.0, orifice_l_per_s_per_sqrt_cmh2o: 0.4, laminar_resistance_cmh2o_per_l_s: 0.5 }
    }
}

/// Breathing circuit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
}

impl Default for CircuitConfig {
    fn default() -> Self {
        Self {
            compliance_ml_per_cmh2o: 1.5,
            leak_l_per_s_at_30_cmh2o: 0.005,
            relief_opening_cmh2o: 70.0,
            relief_conductance_l_per_s_per_cmh2o: 0.3,
        }
    }
}

/// One compartment of the lung.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CompartmentConfig {
    /// Resistance R at small flow, cmH2O/(L/s).
    pub resistance_cmh2o_per_l_s: f64,
    /// k of the parabolic resistor `R q (1 + k |q|)`, s/L.
    pub turbulence_s_per_l: f64,
    /// Compliance C below the upper inflection, mL/cmH2O.
    pub compliance_ml_per_cmh2o: f64,
    /// Pressure above which the compartment stiffens, cmH2O.
    pub upper_inflection_cmh2o: f64,
    /// Distance `V / C` beyond the inflection over which the elastance doubles, cmH2O.
    pub stiffening_cmh2o: f64,
}

impl Default for CompartmentConfig {
    fn default() -> Self {
        Self {
            resistance_cmh2o_per_l_s: 20.0,
            turbulence_s_per_l: 0.1,
            compliance_ml_per_cmh2o: 20.0,
            upper_inflection_cmh2o: 35.0,
            stiffening_cmh2o: 20.0,
        }
    }
}

/// Test lung.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LungConfig {
    /// The compartment that is always present.
    pub first: CompartmentConfig,
    /// A second one in parallel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second: Option<CompartmentConfig>,
}

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

/// The patient's activity, and a change of the lung; all off by default.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PatientConfig {
    /// Peak muscle pressure of an inspiratory effort, a half sine, cmH2O; 0 for none.
    pub effort_cmh2o: f64,
    /// Efforts per minute; the first begins with the simulation.
    pub effort_rate_per_min: f64,
    /// Duration of an effort, s.
    pub effort_duration_s: f64,
    /// Peak expulsive pressure of one cough, a half sine, cmH2O; 0 for none.
    pub cough_cmh2o: f64,
    /// Beginning of the cough, s.
    pub cough_at_s: f64,
    /// Duration of the cough, s.
    pub cough_duration_s: f64,
    /// Breath from which the lung is changed (the first breath is 1); 0 for never.
    pub change_at_breath: u32,
    /// Factor on every resistance from that breath on.
    pub resistance_factor: f64,
    /// Factor on every compliance from that breath on.
    pub compliance_factor: f64,
}

impl Default for PatientConfig {
    fn default() -> Self {
        Self {
            effort_cmh2o: 0.0,
            effort_rate_per_min: 15.0,
            effort_duration_s: 0.8,
            cough_cmh2o: 0.0,
            cough_at_s: 10.0,
            cough_duration_s: 0.3,
            change_at_breath: 0,
            resistance_factor: 1.0,
            compliance_factor: 1.0,
        }
    }
}

/// A complete bench: all parts of ventilator, circuit, lung and patient. The default is R 20, C 20.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BenchConfig {
    /// Name in reports.
    pub name: String,
    /// Sub-steps of one step of 1 ms.
    pub sub_steps: u32,
    /// Inspiratory valve.
    pub valve: ValveConfig,
    /// Expiratory valve.
    pub expiratory: ExpiratoryConfig,
    /// Breathing circuit.
    pub circuit: CircuitConfig,
    /// Test lung.
    pub lung: LungConfig,
    /// Pressure sensor.
    pub sensor: SensorConfig,
    /// Unit of the machine type.
    pub unit: UnitConfig,
    /// Patient.
    pub patient: PatientConfig,
}

impl Default for BenchConfig {
    fn default() -> Self {
        Self {
            name: "R20C20".to_owned(),
            sub_steps: super::LEAST_SUB_STEPS,
            valve: ValveConfig::default(),
            expiratory: ExpiratoryConfig::default(),
            circuit: CircuitConfig::default(),
            lung: LungConfig::default(),
            sensor: SensorConfig::default(),
            unit: UnitConfig::default(),
            patient: PatientConfig::default(),
        }
    }
}

impl BenchConfig {
    /// Reads and validates a description; absent fields have their defaults.
    ///
    /// # Errors
    /// [`BenchError::Syntax`] for text that is not TOML, an unknown field or a wrong type; [`BenchError::OutOfRange`]
    /// for a value outside its range.
    pub fn from_toml(text: &str) -> Result<Self, BenchError> {
        let config: Self = toml::from_str(text)?;
        config.validate()?;
        Ok(config)
    }

    /// The complete description, including defaults, as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("numbers, a string and tables always have a TOML form")
    }

    /// Reads and validates the file at `path`.
    ///
    /// # Errors
    /// [`BenchError::File`] if it cannot be read; otherwise see [`BenchConfig::from_toml`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self, BenchError> {
        let path = path.as_ref();
        let text = std::fs::read_to_string(path)
            .map_err(|source| BenchError::File { path: path.to_path_buf(), source })?;
        Self::from_toml(&text)
    }

    /// Checks that every value is finite and within the range in which the physics are valid.
    ///
    /// # Errors
    /// [`BenchError::OutOfRange`] for the first field that violates this.
    pub fn validate(&self) -> Result<(), BenchError> {
        let Self { name: _, sub_steps, valve, expiratory, circuit, lung, sensor, unit, patient } = self;
        check("sub_steps", f64::from(*sub_steps), f64::from(super::LEAST_SUB_STEPS)..=64.0)?;
        check("valve.dead_time_ms", valve.dead_time_ms, 0.0..=100.0)?;
        check("valve.lag_ms", valve.lag_ms, 0.0..=500.0)?;
        check("valve.backlash_percent", valve.backlash_percent, 0.0..=20.0)?;
        check("valve.dead_zone_percent", valve.dead_zone_percent, 0.0..=50.0)?;
        check("valve.curve_exponent", valve.curve_exponent, 0.5..=4.0)?;
        check("valve.max_flow_l_per_s", valve.max_flow_l_per_s, 0.05..=5.0)?;
        check("valve.supply_pressure_cmh2o", valve.supply_pressure_cmh2o, 50.0..=5000.0)?;
        check("expiratory.lag_ms", expiratory.lag_ms, 0.0..=500.0)?;
        check(
            "expiratory.orifice_l_per_s_per_sqrt_cmh2o",
            expiratory.orifice_l_per_s_per_sqrt_cmh2o,
            0.02..=5.0,
        )?;
        check(
            "expiratory.laminar_resistance_cmh2o_per_l_s",
            expiratory.laminar_resistance_cmh2o_per_l_s,
            0.01..=50.0,
        )?;
        check("circuit.compliance_ml_per_cmh2o", circuit.compliance_ml_per_cmh2o, 0.1..=20.0)?;
        check("circuit.leak_l_per_s_at_30_cmh2o", circuit.leak_l_per_s_at_30_cmh2o, 0.0..=1.0)?;
        check("circuit.relief_opening_cmh2o", circuit.relief_opening_cmh2o, 20.0..=200.0)?;
        check(
            "circuit.relief_conductance_l_per_s_per_cmh2o",
            circuit.relief_conductance_l_per_s_per_cmh2o,
            0.01..=10.0,
        )?;
        lung.first.validate("lung.first")?;
        if let Some(second) = &lung.second {
            second.validate("lung.second")?;
        }
        check("sensor.lag_ms", sensor.lag_ms, 0.0..=100.0)?;
        check("sensor.noise_sd_cmh2o", sensor.noise_sd_cmh2o, 0.0..=5.0)?;
        check("sensor.quantum_cmh2o", sensor.quantum_cmh2o, 0.0..=2.0)?;
        check("unit.flow_gain_sd_percent", unit.flow_gain_sd_percent, 0.0..=20.0)?;
        check("unit.sensor_offset_sd_cmh2o", unit.sensor_offset_sd_cmh2o, 0.0..=5.0)?;
        check("unit.dead_time_sd_ms", unit.dead_time_sd_ms, 0.0..=5.0)?;
        check("unit.sensor_drift_cmh2o_per_hour", unit.sensor_drift_cmh2o_per_hour, -10.0..=10.0)?;
        check("patient.effort_cmh2o", patient.effort_cmh2o, 0.0..=40.0)?;
        check("patient.effort_rate_per_min", patient.effort_rate_per_min, 1.0..=80.0)?;
        let period_s = 60.0 / patient.effort_rate_per_min;
        check("patient.effort_duration_s", patient.effort_duration_s, 0.05..=period_s)?;
        check("patient.cough_cmh2o", patient.cough_cmh2o, 0.0..=150.0)?;
        check("patient.cough_at_s", patient.cough_at_s, 0.0..=1e6)?;
        check("patient.cough_duration_s", patient.cough_duration_s, 0.02..=5.0)?;
        check("patient.resistance_factor", patient.resistance_factor, 0.02..=50.0)?;
        check("patient.compliance_factor", patient.compliance_factor, 0.02..=50.0)?;
        Ok(())
    }
}

/// Refuses a value that is outside `range` or not a number.
pub(super) fn check(field: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), BenchError> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(BenchError::OutOfRange { field: field.to_owned(), value, low: *range.start(), high: *range.end() })
}

impl CompartmentConfig {
    fn validate(&self, table: &str) -> Result<(), BenchError> {
        let check = |field: &str, value, range| check(&format!("{table}.{field}"), value, range);
        check("resistance_cmh2o_per_l_s", self.resistance_cmh2o_per_l_s, 0.5..=1000.0)?;
        check("turbulence_s_per_l", self.turbulence_s_per_l, 0.0..=5.0)?;
        check("compliance_ml_per_cmh2o", self.compliance_ml_per_cmh2o, 0.2..=500.0)?;
        check("upper_inflection_cmh2o", self.upper_inflection_cmh2o, 5.0..=200.0)?;
        check("stiffening_cmh2o", self.stiffening_cmh2o, 1.0..=1000.0)
    }
}
