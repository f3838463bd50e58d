//! Parameters of lung and patient.

use serde::{Deserialize, Serialize};

use super::{BenchError, check};

/// Highest peak muscle pressure of an effort, cmH2O.
pub(crate) const MOST_EFFORT_CMH2O: f64 = 40.0;

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

impl CompartmentConfig {
    fn validate(&self, table: &str) -> Result<(), BenchError> {
        let check = |field: &str, value, range| check(format_args!("{table}.{field}"), value, range);
        check("resistance_cmh2o_per_l_s", self.resistance_cmh2o_per_l_s, 0.5..=1000.0)?;
        check("turbulence_s_per_l", self.turbulence_s_per_l, 0.0..=5.0)?;
        check("compliance_ml_per_cmh2o", self.compliance_ml_per_cmh2o, 0.2..=500.0)?;
        check("upper_inflection_cmh2o", self.upper_inflection_cmh2o, 5.0..=200.0)?;
        check("stiffening_cmh2o", self.stiffening_cmh2o, 1.0..=1000.0)
    }
}

impl LungConfig {
    pub(super) fn validate(&self) -> Result<(), BenchError> {
        self.first.validate("lung.first")?;
        self.second.as_ref().map_or(Ok(()), |second| second.validate("lung.second"))
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
    /// Spread of the peak and of the interval between efforts, percent of their means (sd). A drawn peak stays within
    /// 0 to 40 cmH2O; an effort never begins before the one before it has ended.
    pub effort_variability_percent: f64,
    /// Share of the efforts that a second effort follows at once, percent.
    pub double_efforts_percent: f64,
    /// Share of their strength that the efforts lose and regain again and again, percent.
    pub effort_wanes_percent: f64,
    /// Time in which they do once, s.
    pub effort_wanes_every_s: f64,
    /// Peak expulsive pressure of a cough, a half sine, cmH2O; 0 for none.
    pub cough_cmh2o: f64,
    /// Beginning of the only cough, s; without effect if `coughs_per_hour` is not 0.
    pub cough_at_s: f64,
    /// Duration of a cough, s.
    pub cough_duration_s: f64,
    /// Coughs at random times (a Poisson process), 1/h; 0 for a single cough. A cough never begins before the one
    /// before it has ended.
    pub coughs_per_hour: f64,
    /// Rise of every resistance by secretions, percent of its initial value per hour.
    pub resistance_growth_percent_per_hour: f64,
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
            effort_variability_percent: 0.0,
            double_efforts_percent: 0.0,
            effort_wanes_percent: 0.0,
            effort_wanes_every_s: 60.0,
            cough_cmh2o: 0.0,
            cough_at_s: 10.0,
            cough_duration_s: 0.3,
            coughs_per_hour: 0.0,
            resistance_growth_percent_per_hour: 0.0,
            change_at_breath: 0,
            resistance_factor: 1.0,
            compliance_factor: 1.0,
        }
    }
}

impl PatientConfig {
    pub(super) fn validate(&self) -> Result<(), BenchError> {
        let check = |field: &str, value, range| check(format_args!("patient.{field}"), value, range);
        check("effort_cmh2o", self.effort_cmh2o, 0.0..=MOST_EFFORT_CMH2O)?;
        check("effort_rate_per_min", self.effort_rate_per_min, 1.0..=80.0)?;
        let period_s = 60.0 / self.effort_rate_per_min;
        check("effort_duration_s", self.effort_duration_s, 0.05..=period_s)?;
        check("effort_variability_percent", self.effort_variability_percent, 0.0..=100.0)?;
        check("double_efforts_percent", self.double_efforts_percent, 0.0..=100.0)?;
        check("effort_wanes_percent", self.effort_wanes_percent, 0.0..=100.0)?;
        check("effort_wanes_every_s", self.effort_wanes_every_s, 1.0..=1e6)?;
        check("cough_cmh2o", self.cough_cmh2o, 0.0..=150.0)?;
        check("cough_at_s", self.cough_at_s, 0.0..=1e6)?;
        check("cough_duration_s", self.cough_duration_s, 0.02..=5.0)?;
        check("coughs_per_hour", self.coughs_per_hour, 0.0..=600.0)?;
        let growth = self.resistance_growth_percent_per_hour;
        check("resistance_growth_percent_per_hour", growth, 0.0..=1000.0)?;
        check("resistance_factor", self.resistance_factor, 0.02..=50.0)?;
        check("compliance_factor", self.compliance_factor, 0.02..=50.0)
    }
}
