//! The breaths of a recording: those that are judged, and those that cannot be.

use std::ops::Range;

use serde::Serialize;

use crate::curve::Refusal;
use crate::figures::Figures;
use crate::identify::LungId;

/// A judged breath.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Breath {
    /// Number in the recording.
    pub number: u32,
    /// Its lung.
    #[serde(flatten)]
    pub lung: LungId,
    /// PIP setting, cmH2O.
    pub pip: f64,
    /// PEEP setting, cmH2O.
    pub peep: f64,
    /// Its figures.
    #[serde(flatten)]
    pub figures: Figures,
    /// Volume of the inspiration without the drift of the flow sensors, mL; needs flows and a whole breath.
    pub tidal_volume_ml: Option<f64>,
    /// Highest flow of the inspiration, L/min.
    pub peak_flow_l_min: Option<f64>,
    /// Rows in the recording.
    #[serde(skip)]
    pub rows: Range<usize>,
    /// Whether the targets are set-points.
    #[serde(skip)]
    pub(crate) set_point: bool,
    #[serde(skip)]
    pub(crate) lung_index: usize,
}

impl Breath {
    /// Name of its lung: the test run, else R and C.
    pub fn lung_name(&self) -> String {
        lung_name(&self.lung)
    }
}

/// A breath that cannot be judged.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unjudged {
    /// Number in the recording.
    pub breath: u32,
    /// Name of the lung.
    pub lung: String,
    /// Why it cannot be judged.
    pub reason: Refusal,
}

/// Name of a lung: its test run, else R and C, else `all`.
pub(crate) fn lung_name(lung: &LungId) -> String {
    match (&lung.run, lung.nominal_resistance, lung.nominal_compliance) {
        (None, Some(r), Some(c)) => format!("R{r:.0}C{c:.0}"),
        (Some(_), Some(r), Some(c)) => format!("{lung} (R{r:.0} C{c:.0})"),
        _ => lung.to_string(),
    }
}
