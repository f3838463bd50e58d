//! Parameters of the virtual bench: defaults and allowed ranges.

mod blower;
mod error;
mod failure;
mod fault;
mod machine;
mod patient;
mod sensors;
#[cfg(feature = "std")]
mod text;
mod wire;

pub use blower::BlowerConfig;
pub use error::BenchError;
pub(super) use error::check;
pub use failure::Failure;
pub use fault::{Distortion, FaultConfig, Faulty, Repeats, Signal, Strain};
pub use machine::{CircuitConfig, ExpiratoryConfig, LeakChange, UnitConfig, ValveConfig};
pub(super) use patient::MOST_EFFORT_CMH2O;
pub use patient::{CompartmentConfig, LungConfig, PatientConfig};
pub use sensors::{FlowSensorConfig, OutletSensorConfig, SensorConfig};

use core::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::step::{LEAST_SUB_STEPS, MOST_SUB_STEPS};
use crate::math::sqrt;
use crate::storage::{List, MOST_FAULTS, MOST_NAME_BYTES, Text};

/// Allowed settings of the mechanical PEEP valve, cmH2O.
pub const PEEP_RANGE_CMH2O: RangeInclusive<f64> = 0.0..=50.0;

/// A complete bench: all parts of ventilator, circuit, lung and patient. The default is R 20, C 20.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BenchConfig {
    /// Name in reports.
    pub name: Text<MOST_NAME_BYTES>,
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
    #[serde(skip_serializing_if = "List::is_empty")]
    pub faults: List<FaultConfig, MOST_FAULTS>,
}

impl Default for BenchConfig {
    fn default() -> Self {
        Self {
            name: "R20C20".parse().unwrap_or_default(),
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
            faults: List::new(),
        }
    }
}

impl BenchConfig {
    /// Steady flow of the open inspiratory valve against no pressure, L/s: behind a blower less than the valve alone lets through.
    pub fn full_flow_l_per_s(&self) -> f64 {
        let (alone, source) = (self.valve.max_flow_l_per_s, sqrt(self.valve.supply_pressure_cmh2o));
        self.blower.map_or(alone, |blower| {
            let slowed = 0.01 * blower.sag_percent_per_l_per_s * source;
            source / (sqrt(source * source / (alone * alone) + blower.drop_cmh2o_per_l2_s2) + slowed)
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
        check("sub_steps", f64::from(*sub_steps), f64::from(LEAST_SUB_STEPS)..=f64::from(MOST_SUB_STEPS))?;
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
        #[cfg(not(feature = "std"))]
        if faults.iter().filter_map(FaultConfig::delay_ms).count() > 1 {
            return Err(BenchError::Delays);
        }
        faults.iter().enumerate().try_for_each(|(place, fault)| fault.validate(place))
    }
}
