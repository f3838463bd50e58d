//! The limits of valve and authority over lanes.

use engine::Lane;
use shared::math;

/// Limits each value as on the chip.
#[inline]
pub(super) fn limit(value: &Lane, lo: f32, hi: f32) -> Lane {
    value.map(|value| math::limit(value, lo, hi))
}

/// Gradient through a limit. Outside the limits, only the direction back inside passes, so that a saturated command can
/// learn to leave its limit.
#[inline]
pub(super) fn limit_back(d: &Lane, value: &Lane, lo: f32, hi: f32) -> Lane {
    d.zip(value, |d, value| if (value > hi && d < 0.0) || (value < lo && d > 0.0) { 0.0 } else { d })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_saturated_command_can_only_learn_to_come_back() {
        let value = Lane::from_fn(|l| [120.0, 120.0, -5.0, -5.0][l % 4]);
        let d = Lane::from_fn(|l| [1.0, -1.0, 1.0, -1.0][l % 4]);
        let through = limit_back(&d, &value, 0.0, 100.0);
        assert_eq!(through.0[..4].iter().map(|d| *d as i32).collect::<Vec<_>>(), [1, 0, 0, -1]);
    }

    #[test]
    fn between_the_limits_the_slope_is_that_of_finite_differences() {
        let value = Lane::from_fn(|l| 3.0 + 6.0 * l as f32);
        let at = |step: f32| limit(&value.map(|value| value + step), 0.0, 100.0);
        let numeric = at(0.5).zip(&at(-0.5), |above, below| above - below);
        assert_eq!(limit_back(&Lane::splat(1.0), &value, 0.0, 100.0), numeric);
    }
}
