//! The step of the bench.

/// Duration of one [`super::Bench::step`], microseconds.
pub const STEP_US: u32 = 1000;
/// Duration of one [`super::Bench::step`], s.
pub const STEP_S: f64 = STEP_US as f64 * 1e-6;
/// Minimum and default number of sub-steps of a step: the error of the implicit solution grows with their
/// length.
pub const LEAST_SUB_STEPS: u32 = 4;
/// Maximum number of sub-steps of a step: a chip has time for the minimum only.
pub const MOST_SUB_STEPS: u32 = if cfg!(feature = "std") { 64 } else { LEAST_SUB_STEPS };
