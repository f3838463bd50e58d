//! A loop at one operating point.

use serde::{Deserialize, Serialize};

use crate::operating_point::OperatingPoint;
use tuning::response::ResponsePoint;
use tuning::stability::Margins;

/// A loop measured at one operating point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPoint {
    /// The operating point.
    #[serde(flatten)]
    pub point: OperatingPoint,
    /// Standard deviation of the pressure reading at rest, before any sine, cmH2O.
    pub rest_sd_cmh2o: f64,
    /// Its margins; none if it oscillates by itself.
    pub margins: Option<Margins>,
    /// Its margins with twice the amplitude.
    pub doubled: Option<Margins>,
    /// Share of the time in which the command with the sine reached the valve's limits.
    pub limited: f64,
    /// The response from which the margins were read.
    pub response: Vec<ResponsePoint>,
}
