//! The shape of an effort and of a cough.

use core::f64::consts::PI;

use crate::math::sin;

/// A half sine of `duration`, 0 outside.
pub(super) fn pulse(since_start_s: f64, duration_s: f64) -> f64 {
    if (0.0..duration_s).contains(&since_start_s) { sin(PI * since_start_s / duration_s) } else { 0.0 }
}
