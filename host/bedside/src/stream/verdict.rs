//! The verdict on a recording.

use serde::Serialize;

/// The verdict on a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Verdict {
    /// Why there is none.
    pub refused: Option<String>,
    /// Judged breaths.
    pub breaths: usize,
    /// Breaths that cannot be judged.
    pub unjudged: usize,
    /// Breaths that violate a limit.
    pub violating: usize,
    /// Mean absolute error over the inspirations, cmH2O.
    pub error: Option<f64>,
    /// Share of the inspiratory ticks with a random perturbation, 0 to 1.
    pub explored: f64,
    /// Accuracy at the end of the inspiration.
    pub inspiration: Option<Tolerance>,
    /// Accuracy at the end of the expiration.
    pub expiration: Option<Tolerance>,
    /// Each limit.
    pub limits: Vec<LimitCheck>,
    /// What is wrong most, in words, the most severe first.
    pub sore_spots: Vec<String>,
}

/// A tolerance: fixed, plus a percentage of the set pressure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Tolerance {
    /// Fixed part, in the unit of what it limits.
    pub fixed: f64,
    /// Percent of the set pressure.
    pub percent: f64,
}

/// One limit on all breaths of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitCheck {
    /// What is limited.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The limit.
    pub limit: Tolerance,
    /// Breaths whose value is known.
    pub checked: usize,
    /// Breaths that violate it.
    pub violations: usize,
    /// The largest value that violates it, and its breath.
    pub worst: Option<f64>,
    /// Number of that breath in the recording.
    pub worst_breath: Option<u32>,
}
