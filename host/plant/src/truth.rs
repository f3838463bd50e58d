//! What only a virtual plant knows, and no controller sees.

/// What only a bench knows of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickTruth {
    /// Pressure at the airway, cmH2O.
    pub airway_pressure: f32,
    /// Pressure behind the sensor's lag, before noise and quantum, cmH2O.
    pub sensor_pressure: f32,
    /// Gas in the lung above its volume at rest, mL.
    pub lung_volume: f32,
}
