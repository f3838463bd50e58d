//! What can fail.

use serde::{Deserialize, Serialize};

/// A failure of a part; it lasts until [`Bench::restore`](crate::Bench::restore).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Failure {
    /// Occluded tube: no flow between machine and lung.
    TubeOccluded,
    /// Partly occluded tube: this factor on the lung's resistances.
    TubeNarrowed(f64),
    /// Clogged expiratory filter: almost no flow.
    FilterClogged,
    /// Partly clogged expiratory filter: this share of the flow is left.
    FilterNarrowed(f64),
    /// Disconnected tube.
    Disconnected,
    /// A leak of this flow in L/s at 30 cmH2O.
    Leak(f64),
    /// The stem of the inspiratory valve is stuck at this percentage.
    InspiratoryValveStuck(f64),
    /// The stem of the inspiratory valve lags by this backlash, percent of the full command.
    ValveLoose(f64),
    /// The stem of the inspiratory valve is stuck at this percentage, and the expiratory valve stays closed.
    BothValvesStuck(f64),
    /// The expiratory valve stays closed.
    ExpiratoryValveClosed,
    /// The PEEP valve is stuck at this pressure, cmH2O.
    PeepValveStuck(f64),
    /// The gas supply is lost.
    SupplyLost,
    /// The pressure of the gas supply falls: this share of the flow is left.
    SupplyFalls(f64),
}
