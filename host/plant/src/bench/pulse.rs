//! The shape of an effort and of a cough.

use std::f64::consts::PI;

/// A half sine of `duration`, 0 outside.
pub(super) fn pulse(since_start_s: f64, duration_s: f64) -> f64 {
    if (0.0..duration_s).contains(&since_start_s) { (PI * since_start_s / duration_s).sin() } else { 0.0 }
}
