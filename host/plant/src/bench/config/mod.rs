//! Parameters of the virtual bench: defaults, allowed ranges, TOML.

mod blower;
mod fault;
mod machine;
mod patient;
mod sensors;

pub use blower::BlowerConfig;
pub use fault::{Distortion, FaultConfig, Faulty, Repeats, Signal, Strain};
pub use machine::{CircuitConfig, ExpiratoryConfig, LeakChange, UnitConfig, ValveConfig};
pub(super) use patient::MOST_EFFORT_CMH2O;
pub use patient::{CompartmentConfig, LungConfig, PatientConfig};
pub use sensors::{FlowSensorConfig, OutletSensorConfig, SensorConfig};

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::step::{LEAST_SUB_STEPS, STEP_US};

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
    /// The changes of the leak are not in the order of their times.
    #[error(
        "circuit.leak_changes[{place}].at_s = {at_s} is not later than the change before it, at {before_s} s: \
         sort the changes by time"
    )]
    LeakOrder {
        /// Place of the change in the list; the first is 0.
        place: usize,
        /// Its time, s.
        at_s: f64,
        /// Time of the change before it, s.
        before_s: f64,
    },
    /// A fault ends before it begins, or recurs before it has ended.
    #[error("faults[{place}] {problem}")]
    FaultTimes {
        /// Place of the fault in the list; the first is 0.
        place: usize,
        /// What is wrong, and what to do.
        problem: &'static str,
    },
    /// The control period is not a multiple of the bench's step.
    #[error("the control period must be a multiple of the bench's step of {STEP_US} us, not {period_us} us")]
    Period {
        /// Requested control period, microseconds.
        period_us: u32,
    },
    /// There is no lung or preset of that name.
    #[error(
        "unknown lung \"{0}\": use R<cmH2O/(L/s)>C<mL/cmH2O> (such as R20C20), iso-01 to iso-21, either of them on \
         the machine for newborns as in neonate-R100C2, or for several lungs paper, iso, iso-matched or neonate-iso; or name a TOML file"
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
    /// Blower that supplies it; absent: a gas supply of constant pressure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blower: Option<BlowerConfig>,
    /// Expiratory valve.
    pub expiratory: ExpiratoryConfig,
    /// Breathing circuit.
    pub circuit: CircuitConfig,
    /// Test lung.
    pub lung: LungConfig,
    /// Pressure sensor at the airway opening.
    pub sensor: SensorConfig,
    /// Pressure sensor at the machine's outlet.
    pub outlet_sensor: OutletSensorConfig,
    /// Flow sensor at the airway opening.
    pub flow_sensor: FlowSensorConfig,
    /// Unit of the machine type.
    pub unit: UnitConfig,
    /// Patient.
    pub patient: PatientConfig,
    /// Faults that begin at stated times; usually none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<FaultConfig>,
}

impl Default for BenchConfig {
    fn default() -> Self {
        Self {
            name: "R20C20".to_owned(),
            sub_steps: LEAST_SUB_STEPS,
            valve: ValveConfig::default(),
            blower: None,
            expiratory: ExpiratoryConfig::default(),
            circuit: CircuitConfig::default(),
            lung: LungConfig::default(),
            sensor: SensorConfig::default(),
            outlet_sensor: OutletSensorConfig::default(),
            flow_sensor: FlowSensorConfig::default(),
            unit: UnitConfig::default(),
            patient: PatientConfig::default(),
            faults: Vec::new(),
        }
    }
}

impl BenchConfig {
    /// Reads and validates a description; absent fields have their defaults.
    ///
    /// # Errors
    /// [`BenchError::Syntax`] for text that is not TOML, an unknown field or a wrong type; [`BenchError::OutOfRange`]
    /// and [`BenchError::LeakOrder`] as in [`BenchConfig::validate`].
    pub fn from_toml(text: &str) -> Result<Self, BenchError> {
        let config: Self = toml::from_str(text)?;
        config.validate()?;
        Ok(config)
    }

    /// The complete description, including defaults, as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("numbers, strings, tables and arrays of tables always have a TOML form")
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

    /// Steady flow of the open inspiratory valve against no pressure, L/s: behind a blower less than the valve alone lets through.
    pub fn full_flow_l_per_s(&self) -> f64 {
        let (alone, source) = (self.valve.max_flow_l_per_s, self.valve.supply_pressure_cmh2o.sqrt());
        self.blower.map_or(alone, |blower| {
            let slowed = 0.01 * blower.sag_percent_per_l_per_s * source;
            source / ((source / alone).hypot(blower.drop_cmh2o_per_l2_s2.sqrt()) + slowed)
        })
    }

    /// Checks that every value is finite and within the range in which the physics are valid.
    ///
    /// # Errors
    /// [`BenchError::OutOfRange`] for the first field that violates this; [`BenchError::LeakOrder`] for changes of the
    /// leak that are not in the order of their times; [`BenchError::FaultTimes`] for a fault without a time.
    pub fn validate(&self) -> Result<(), BenchError> {
        let Self {
            name: _,
            sub_steps,
            valve,
            blower,
            expiratory,
            circuit,
            lung,
            sensor,
            outlet_sensor,
            flow_sensor,
            unit,
            patient,
            faults,
        } = self;
        check("sub_steps", f64::from(*sub_steps), f64::from(LEAST_SUB_STEPS)..=64.0)?;
        valve.validate()?;
        blower.as_ref().map_or(Ok(()), BlowerConfig::validate)?;
        expiratory.validate()?;
        circuit.validate()?;
        lung.validate()?;
        sensor.validate("sensor")?;
        outlet_sensor.validate()?;
        flow_sensor.validate()?;
        unit.validate()?;
        patient.validate()?;
        faults.iter().enumerate().try_for_each(|(place, fault)| fault.validate(place))
    }
}

/// Refuses a value that is outside `range` or not a number.
pub(super) fn check(field: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), BenchError> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(BenchError::OutOfRange { field: field.to_owned(), value, low: *range.start(), high: *range.end() })
}
