//! The inputs of the authors' network: running averages of the last ten errors, over lanes and for one breath.
//!
//! Average `j` is the mean of the last `10 - j` errors, so the first input is the mean of all ten and the last one the newest
//! error alone. Errors before the breath count as zero, as in the authors' code.

use engine::Lane;
use shared::control::features::ERROR_SCALE;

/// Number of errors, and of their averages.
pub const ERRORS: usize = 10;

/// The averages of the scaled errors, newest first.
pub fn averages(newest_first: &[f32; ERRORS]) -> [f32; ERRORS] {
    let (mut sum, mut out) = (0.0, [0.0; ERRORS]);
    for (count, error) in newest_first.iter().enumerate() {
        sum += error;
        out[ERRORS - 1 - count] = sum * share(count);
    }
    out
}

/// Factor of the sum of an error and the `earlier` ones after it in their mean.
fn share(earlier: usize) -> f32 {
    1.0 / (earlier + 1) as f32
}

/// Like [`averages`], at a tick of a shard's errors (cmH2O), which are `spacing` ticks apart.
pub(super) fn forward(errors: &[Lane], tick: usize, spacing: usize, out: &mut [Lane]) {
    let mut sum = Lane::ZERO;
    for count in 0..ERRORS {
        if let Some(then) = tick.checked_sub(count * spacing) {
            sum.add_scaled(1.0 / ERROR_SCALE, &errors[then]);
        }
        out[ERRORS - 1 - count] = sum.map(|sum| sum * share(count));
    }
}

/// Backward pass of [`forward`]: adds the gradient with respect to the errors.
pub(super) fn backward(d: &[Lane], tick: usize, spacing: usize, d_errors: &mut [Lane]) {
    let mut d_sum = Lane::ZERO;
    for count in (0..ERRORS).rev() {
        d_sum.add_scaled(share(count), &d[ERRORS - 1 - count]);
        if let Some(then) = tick.checked_sub(count * spacing) {
            d_errors[then].add_scaled(1.0 / ERROR_SCALE, &d_sum);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;
    use engine::LANES;

    #[test]
    fn the_averages_are_those_of_ever_fewer_errors_down_to_the_newest_alone() {
        let found = averages(&std::array::from_fn(|n| n as f32));
        assert!((found[0] - 4.5).abs() < 1e-6, "mean of all ten");
        assert!((found[8] - 0.5).abs() < 1e-6, "mean of the last two");
        assert!(found[9].abs() < 1e-6, "the newest");
    }

    #[test]
    fn errors_before_the_breath_count_as_zero() {
        let mut out = [Lane::ZERO; ERRORS];
        forward(&[Lane::splat(20.0)], 0, 3, &mut out);
        assert!((out[9][0] - 2.0).abs() < 1e-6 && (out[0][0] - 0.2).abs() < 1e-6);
    }

    #[test]
    fn gradients_by_errors_agree_with_finite_differences() {
        const TICKS: usize = 40;
        let weight = |tick: usize, n: usize| 10.0 * ((7 * tick + 3 * n) as f32).cos();
        let run = |errors: &[f32]| {
            let errors: Vec<Lane> = errors.iter().map(|e| Lane::splat(*e)).collect();
            let mut total = 0.0;
            for tick in 0..TICKS {
                let mut out = [Lane::ZERO; ERRORS];
                forward(&errors, tick, 3, &mut out);
                total += (0..ERRORS).map(|n| f64::from(weight(tick, n) * out[n][LANES - 1])).sum::<f64>();
            }
            total
        };
        let errors: Vec<f32> = (0..TICKS).map(|tick| 5.0 * (0.3 * tick as f32).sin()).collect();
        let mut d_errors = vec![Lane::ZERO; TICKS];
        for tick in (0..TICKS).rev() {
            let d: [Lane; ERRORS] = std::array::from_fn(|n| Lane::splat(weight(tick, n)));
            backward(&d, tick, 3, &mut d_errors);
        }
        let first: Vec<f32> = d_errors.iter().map(|lane| lane[0]).collect();
        check_slopes("error", &errors, 1e-2, &first, run);
    }
}
