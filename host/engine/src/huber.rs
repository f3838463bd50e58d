//! Huber loss: a parabola up to a bound, a straight line of slope one beyond it.

/// The loss of an error.
#[inline]
pub fn value(error: f32, bound: f32) -> f32 {
    let size = error.abs();
    if size < bound { 0.5 * size * size / bound } else { size - 0.5 * bound }
}

/// The derivative of [`value`] with respect to the error.
#[inline]
pub fn slope(error: f32, bound: f32) -> f32 {
    (error / bound).clamp(-1.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_agrees_with_finite_differences() {
        let step = 1e-3;
        for error in [-2.0, -0.31, -0.2, -0.01, 0.02, 0.28, 0.35, 1.5] {
            let numeric = (value(error + step, 0.3) - value(error - step, 0.3)) / (2.0 * step);
            assert!((slope(error, 0.3) - numeric).abs() < 1e-3, "at {error}: {numeric}");
        }
    }

    #[test]
    fn parabola_and_line_meet_at_the_bound() {
        assert!((value(0.3, 0.3) - 0.15).abs() < 1e-6 && (value(-0.299_99, 0.3) - 0.15).abs() < 1e-4);
    }
}
