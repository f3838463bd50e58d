//! What a simulator is told when a breath starts.

use super::PRESSURE_SCALE;
use data::identity::LungParameters;
use engine::{LANES, Lane};

/// Pressure before a breath that counts as zero, cmH2O.
const USUAL_PEEP: f32 = 5.0;

/// The lung where nothing is known of it: the middle of the paper's.
pub const USUAL_LUNG: LungParameters = LungParameters { resistance: 20.0, compliance: 20.0 };

/// Which member of a family (test runs, ventilators) each lane is of; none for one that no simulator knows.
pub type Members = [Option<u32>; LANES];

/// What a simulator is told of the state in which a breath starts, and of the lung that it is for.
#[derive(Clone, Copy, Debug)]
pub struct BreathStart {
    /// Pressure just before the breath, cmH2O.
    pub pressure: Lane,
    /// Pressure at the end of the last inspiration, cmH2O: what may still be in the lung.
    pub plateau: Lane,
    /// Scaled command of the inspiratory valve just before the breath; only [`hybrid`](super::hybrid) looks at it.
    pub rest: Lane,
    /// The same at the end of the last inspiration.
    pub plateau_command: Lane,
    /// Group (test run) of the recording that a breath is of.
    pub group: Members,
    /// Ventilator of the recording that a breath is of.
    pub ventilator: Members,
    /// Nominal resistance of the lung, cmH2O/(L/s); only [`hybrid`](super::hybrid) looks at it.
    pub resistance: Lane,
    /// Nominal compliance of the lung, mL/cmH2O; only [`hybrid`](super::hybrid) looks at it.
    pub compliance: Lane,
}

impl Default for BreathStart {
    fn default() -> Self {
        let LungParameters { resistance, compliance } = USUAL_LUNG;
        Self {
            pressure: Lane::ZERO,
            plateau: Lane::ZERO,
            rest: Lane::ZERO,
            group: [None; LANES],
            ventilator: [None; LANES],
            plateau_command: Lane::ZERO,
            resistance: Lane::splat(resistance),
            compliance: Lane::splat(compliance),
        }
    }
}

impl BreathStart {
    /// Number of quantities in [`Self::known`].
    pub(crate) const KNOWN: usize = 4;

    /// What pressures and commands before the breath were, scaled for a network.
    pub(crate) fn known(&self) -> [Lane; Self::KNOWN] {
        let (mean, scale) = PRESSURE_SCALE;
        [
            self.pressure.map(|p| (p - USUAL_PEEP) / scale),
            self.plateau.map(|p| (p - mean) / scale),
            self.rest,
            self.plateau_command,
        ]
    }
}
