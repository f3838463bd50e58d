//! Robust least squares in a box: Levenberg and Marquardt's steps with finite differences.

use engine::least_squares::solve;

/// Residual from which on its weight falls.
const SOFT: f64 = 2.0;
/// Part of the box over which a difference is taken: longer than the sub-step to which dead times are rounded.
const DIFFERENCE: f64 = 0.01;
/// Gain of a step, as a share of the cost, below which the fit ends; and the most steps that are tried.
const LEAST_GAIN: f64 = 1e-4;
const MOST_STEPS: usize = 40;
/// Damping, as a share of a column's length: at first, at least and at most.
const DAMPING: f64 = 1e-2;
const LEAST_DAMPING: f64 = 1e-6;
const MOST_DAMPING: f64 = 1e4;

/// Cost of residuals: squares of small ones, the magnitude of large ones.
fn cost(residuals: &[f64]) -> f64 {
    residuals.iter().map(|r| 2.0 * ((1.0 + (r / SOFT).powi(2)).sqrt() - 1.0)).sum()
}

/// The point of the unit box, from `start` on, at which the residuals of `model` have the least cost.
pub(super) fn fit<const N: usize>(start: [f64; N], model: impl Fn(&[f64; N]) -> Vec<f64>) -> [f64; N] {
    let mut point = start;
    let mut residuals = model(&point);
    let mut damping = DAMPING;
    for _ in 0..MOST_STEPS {
        let slopes = slopes(&point, &residuals, &model);
        let before = cost(&residuals);
        loop {
            let next = step(&point, &residuals, &slopes, damping);
            let found = model(&next);
            let after = cost(&found);
            if after < before {
                (point, residuals) = (next, found);
                damping = (damping * 0.2).max(LEAST_DAMPING);
                break;
            }
            damping *= 5.0;
            if damping > MOST_DAMPING {
                return point;
            }
        }
        if cost(&residuals) > (1.0 - LEAST_GAIN) * before {
            break;
        }
    }
    point
}

/// Slopes of the residuals by each coordinate, a row for each residual; the differences stay within the box.
fn slopes<const N: usize>(
    point: &[f64; N],
    residuals: &[f64],
    model: &impl Fn(&[f64; N]) -> Vec<f64>,
) -> Vec<[f64; N]> {
    let mut rows = vec![[0.0; N]; residuals.len()];
    for n in 0..N {
        let mut beside = *point;
        beside[n] += if point[n] > 0.5 { -DIFFERENCE } else { DIFFERENCE };
        let distance = beside[n] - point[n];
        for ((row, there), here) in rows.iter_mut().zip(model(&beside)).zip(residuals) {
            row[n] = (there - here) / distance;
        }
    }
    rows
}

/// A damped step. A coordinate at the wall towards which the cost falls stays where it is.
fn step<const N: usize>(point: &[f64; N], residuals: &[f64], slopes: &[[f64; N]], damping: f64) -> [f64; N] {
    let weights: Vec<f64> = residuals.iter().map(|r| (1.0 + (r / SOFT).powi(2)).powf(-0.25)).collect();
    let mut rows: Vec<[f64; N]> =
        slopes.iter().zip(&weights).map(|(row, weight)| row.map(|slope| slope * weight)).collect();
    let mut values: Vec<f64> = residuals.iter().zip(&weights).map(|(r, weight)| -r * weight).collect();
    for n in 0..N {
        let downhill: f64 = rows.iter().zip(&values).map(|(row, value)| row[n] * value).sum();
        if point[n] <= 0.0 && downhill < 0.0 || point[n] >= 1.0 && downhill > 0.0 {
            for row in &mut rows {
                row[n] = 0.0;
            }
        }
        let length = rows.iter().map(|row| row[n] * row[n]).sum::<f64>().sqrt();
        let mut damper = [0.0; N];
        damper[n] = damping.sqrt() * length + f64::EPSILON;
        rows.push(damper);
        values.push(0.0);
    }
    let Some(solution) = solve(&rows, &values) else { return *point };
    std::array::from_fn(|n| (point[n] + solution.coefficients[n]).clamp(0.0, 1.0))
}
