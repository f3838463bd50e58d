//! The lung as a model-based law knows it.

/// A lung of one compartment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lung {
    /// Resistance, cmH2O/(L/s).
    pub resistance: f32,
    /// Compliance, mL/cmH2O.
    pub compliance: f32,
}

impl Lung {
    /// The lung part of the way to another one.
    #[must_use]
    pub fn towards(self, other: Self, share: f32) -> Self {
        Self {
            resistance: self.resistance + share * (other.resistance - self.resistance),
            compliance: self.compliance + share * (other.compliance - self.compliance),
        }
    }
}
