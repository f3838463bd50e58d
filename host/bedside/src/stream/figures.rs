//! The figures of a breath, and their course over hours.

use std::collections::BTreeMap;

use serde::Serialize;

/// Figures of a breath; null where unknown. Pressures in cmH2O.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BreathFigures {
    /// Number of the breath since the start of ventilation.
    pub number: u32,
    /// Highest pressure.
    pub pip: Option<f32>,
    /// Mean pressure at the end of the inspiration.
    pub plateau: Option<f32>,
    /// Mean pressure at the end of the breath.
    pub peep: Option<f32>,
    /// Inspired volume, mL.
    pub tidal_volume: Option<f32>,
    /// Inspired volume in a minute, L/min.
    pub minute_volume: Option<f32>,
    /// Rate of this breath, 1/min.
    pub rate: Option<f32>,
    /// Set rate, 1/min.
    pub rate_set: Option<f32>,
    /// Time of the expiration, relative to that of the inspiration.
    pub ie: Option<f32>,
    /// Resistance, cmH2O/(L/s).
    pub resistance: Option<f32>,
    /// Compliance, mL/cmH2O.
    pub compliance: Option<f32>,
    /// Leak, L/min.
    pub leak: Option<f32>,
    /// Mean absolute error over the inspiration.
    pub error: Option<f32>,
    /// Time from 10 to 90 % of the way from PEEP to PIP, ms.
    pub rise_ms: Option<f32>,
    /// Highest pressure above PIP.
    pub overshoot: Option<f32>,
    /// Whether flow and volumes are estimated.
    pub estimated: bool,
    /// Whether an effort of the patient has started the breath.
    pub triggered: bool,
}

/// Figures of the breaths in the last 72 hours, minute by minute; minutes without a breath are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct History {
    /// Numbers of the minutes since 1970, ascending.
    pub minutes: Vec<u64>,
    /// Breaths in each.
    pub breaths: Vec<u16>,
    /// The figures by name, in the units of [`BreathFigures`].
    pub figures: BTreeMap<&'static str, Course>,
}

/// One figure, minute by minute; null where it is not known.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Course {
    /// Lowest value of the minute.
    pub low: Vec<f32>,
    /// Mean value.
    pub mean: Vec<f32>,
    /// Highest value.
    pub high: Vec<f32>,
}
