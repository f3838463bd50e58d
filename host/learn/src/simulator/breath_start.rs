//! The state in which a breath starts, as a simulator sees it.

use super::PRESSURE_SCALE;
use data::identity::LungParameters;
use engine::{LANES, Lane};

/// Pressure before a breath that is scaled to zero, cmH2O.
pub(crate) const USUAL_PEEP: f32 = 5.0;

/// The lung assumed if nothing is known: the middle of the paper's.
pub const USUAL_LUNG: LungParameters = LungParameters { resistance: 20.0, compliance: 20.0 };

/// The member of a family (test runs, ventilators) in each lane; `None` for one unknown to the simulator.
pub type Members = [Option<u32>; LANES];

/// The state in which a breath starts, and its lung, as a simulator sees them.
#[derive(Clone, Copy, Debug)]
pub struct BreathStart {
    /// Pressure just before the breath, cmH2O.
    pub pressure: Lane,
    /// PEEP, cmH2O; used only by [`unit`](super::unit).
    pub peep: Lane,
    /// Pressure at the end of the last inspiration, cmH2O, which indicates the volume still in the lung.
    pub plateau: Lane,
    /// Inspiratory and expiratory time of the breath before, s; used only by [`unit`](super::unit), which takes the usual ones if
    /// they are not known.
    pub phases: Option<[Lane; 2]>,
    /// Flow that is drawn out of the circuit during the breath, as a share of the valve's full flow; used only by
    /// [`unit`](super::unit).
    pub drawn: Lane,
    /// Scaled command of the inspiratory valve just before the breath; used only by [`hybrid`](super::hybrid).
    pub rest: Lane,
    /// Scaled command of the inspiratory valve at the end of the last inspiration.
    pub plateau_command: Lane,
    /// Group (test run) of the breath in the recording.
    pub group: Members,
    /// Ventilator of the breath in the recording.
    pub ventilator: Members,
    /// Nominal resistance of the lung, cmH2O/(L/s); used only by [`hybrid`](super::hybrid).
    pub resistance: Lane,
    /// Nominal compliance of the lung, mL/cmH2O; used only by [`hybrid`](super::hybrid).
    pub compliance: Lane,
}

impl Default for BreathStart {
    fn default() -> Self {
        let LungParameters { resistance, compliance } = USUAL_LUNG;
        Self {
            pressure: Lane::ZERO,
            peep: Lane::splat(USUAL_PEEP),
            plateau: Lane::ZERO,
            phases: None,
            drawn: Lane::ZERO,
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

    /// Pressures and commands before the breath, scaled for a network.
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
