//! What a fit tells of a unit.

use learn::pipeline::commission::Figures;
use serde::{Deserialize, Serialize};

/// Figures of a unit's recording and simulator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitFigures {
    /// The figures.
    #[serde(flatten)]
    pub figures: Figures,
    /// Flow of the inspiratory valve at a quarter, half, three quarters and all of its command, L/s.
    pub valve_flow: [f32; 4],
    /// Why no controller is trained on the simulator; none if one may be.
    pub unfit: Option<String>,
}
