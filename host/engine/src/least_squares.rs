//! Linear least squares with confidence intervals that account for correlated residuals within a breath.

use nalgebra::{SMatrix, SVector};

/// Half-width of a 95 % interval in standard errors, by degrees of freedom from 1 (Student's t); 1.96 beyond the table.
const STUDENT: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
];
/// Share of its length below which a column counts as a combination of the others.
const LEAST_INDEPENDENCE: f64 = 1e-6;
/// Upper limit of the correlation between residuals of neighbouring rows.
const MOST_CORRELATION: f64 = 0.999;

/// Solution of a linear model, with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution<const N: usize> {
    /// Coefficients of the columns.
    pub coefficients: [f64; N],
    /// Half-widths of their 95 % intervals.
    pub half_widths: [f64; N],
    /// Root mean square of the residuals.
    pub residual: f64,
    /// Number of independent draws that the rows count as, minus the coefficients.
    pub independent: f64,
}

/// Half-width of a 95 % interval, in standard errors.
pub fn student(degrees: usize) -> f64 {
    STUDENT.get(degrees.wrapping_sub(1)).copied().unwrap_or(1.96)
}

/// The coefficients that fit `rows` (the columns of each row) to `values` with the least squared error.
///
/// The rows of a recording are not independent draws: the residuals of neighbouring rows are correlated. Rows are
/// therefore counted as `n (1 - r) / (1 + r)` draws, where `r` is the correlation of neighbouring residuals.
///
/// `None` if there are too few rows, a number is not finite, or columns are linearly dependent.
pub fn solve<const N: usize>(rows: &[[f64; N]], values: &[f64]) -> Option<Solution<N>> {
    if rows.len() != values.len() || rows.len() <= N {
        return None;
    }
    // Scale columns to length one, so that the test for independence does not depend on units.
    let mut lengths = SVector::<f64, N>::zeros();
    for row in rows {
        lengths += SVector::from(*row).component_mul(&SVector::from(*row));
    }
    let lengths = lengths.map(f64::sqrt);
    if !lengths.iter().all(|length| *length > 0.0 && length.is_finite()) {
        return None;
    }
    let scaled = |row: &[f64; N]| SVector::<f64, N>::from(*row).component_div(&lengths);
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = SVector::<f64, N>::zeros();
    for (row, value) in rows.iter().zip(values) {
        let row = scaled(row);
        normal.syger(1.0, &row, &row, 1.0);
        right += row * *value;
    }
    normal.fill_upper_triangle_with_lower_triangle();
    let factor = normal.cholesky()?;
    if !factor.l_dirty().diagonal().iter().all(|pivot| *pivot > LEAST_INDEPENDENCE) {
        return None;
    }
    let solution = factor.solve(&right);
    let left: Vec<f64> =
        rows.iter().zip(values).map(|(row, value)| value - scaled(row).dot(&solution)).collect();
    let sum: f64 = left.iter().map(|e| e * e).sum();
    let independent = independent(&left, N);
    let variance = sum / independent;
    let spread = factor.inverse().diagonal() * variance;
    let half_widths = spread.map(f64::sqrt).component_div(&lengths) * student(usize::MAX);
    let solution = Solution {
        coefficients: solution.component_div(&lengths).into(),
        half_widths: half_widths.into(),
        residual: (sum / rows.len() as f64).sqrt(),
        independent,
    };
    solution.coefficients.iter().all(|c| c.is_finite()).then_some(solution)
}

/// Effective number of independent draws, minus the `used` coefficients; at least one.
fn independent(left: &[f64], used: usize) -> f64 {
    let product: f64 = left.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let square: f64 = left.iter().map(|e| e * e).sum();
    let correlation = if square > 0.0 { (product / square).clamp(0.0, MOST_CORRELATION) } else { 0.0 };
    (left.len() as f64 * (1.0 - correlation) / (1.0 + correlation) - used as f64).max(1.0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;

    fn rows(count: usize) -> Vec<[f64; 3]> {
        (0..count).map(|n| n as f64 * 0.1).map(|t| [1.0, t.sin(), 500.0 * (0.3 * t).cos()]).collect()
    }

    fn values(rows: &[[f64; 3]], coefficients: [f64; 3]) -> Vec<f64> {
        rows.iter().map(|row| row.iter().zip(coefficients).map(|(x, c)| x * c).sum()).collect()
    }

    proptest! {
        #[test]
        fn an_exact_model_is_found_exactly(a in -50.0..50.0, b in -50.0..50.0, c in -0.5..0.5) {
            let rows = rows(200);
            let found = solve(&rows, &values(&rows, [a, b, c])).unwrap();
            for (found, true_one) in found.coefficients.iter().zip([a, b, c]) {
                prop_assert!((found - true_one).abs() < 1e-7, "{found} {true_one}");
            }
            prop_assert!(found.residual < 1e-7);
        }
    }

    /// Share of 400 data sets whose interval contains the true coefficient, with this correlation of the noise.
    fn coverage(correlation: f64) -> f64 {
        let normal = Normal::new(0.0, 1.0).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let rows = rows(400);
        let mut hits = 0;
        for _ in 0..400 {
            let mut noise = 0.0;
            let mut values = values(&rows, [1.0, 2.0, 0.03]);
            for value in &mut values {
                noise =
                    correlation * noise + (1.0_f64 - correlation.powi(2)).sqrt() * normal.sample(&mut random);
                *value += noise;
            }
            let found = solve(&rows, &values).unwrap();
            hits += u32::from((found.coefficients[1] - 2.0).abs() < found.half_widths[1]);
        }
        f64::from(hits) / 400.0
    }

    #[test]
    fn intervals_hold_the_truth_whether_or_not_residuals_hang_together() {
        for correlation in [0.0, 0.8] {
            let share = coverage(correlation);
            assert!((0.9..=0.99).contains(&share), "correlation {correlation}: {share}");
        }
    }

    #[test]
    fn what_cannot_be_told_apart_is_refused() {
        let twice: Vec<[f64; 2]> = (0..50).map(|n| [f64::from(n), 2.0 * f64::from(n)]).collect();
        assert_eq!(solve(&twice, &vec![1.0; 50]), None);
        assert_eq!(solve(&[[1.0, 0.0]; 50], &[1.0; 50]), None, "a flow that never moves");
        assert_eq!(solve(&[[1.0, f64::NAN]; 50], &[1.0; 50]), None);
        assert_eq!(solve(&[[1.0, 2.0]; 2], &[1.0; 2]), None, "no row left to judge by");
    }

    #[test]
    fn few_draws_widen_an_interval() {
        assert!(student(1) > 12.0 && (student(30) - 2.042).abs() < 1e-9 && (student(31) - 1.96).abs() < 1e-9);
        assert!(student(0).is_finite());
    }
}
