//! Values with their 95 % intervals, from fits of several breaths.

use serde::Serialize;

use super::cycle::{COEFFICIENTS, Cycle, Drift, FitSpan, FlowPath};
use crate::series::median;
use engine::least_squares::{Solution, student};

/// A value with its 95 % confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The estimated value.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Estimate {
    /// The interval that has both intervals, around the value of this one.
    pub(super) fn hull(&self, other: &Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high), ..*self }
    }

    /// The interval widened by an independent deviation of the value.
    pub(super) fn widened(&self, by: f64) -> Self {
        let wider = |half: f64| (half * half + by * by).sqrt();
        Self {
            value: self.value,
            low: self.value - wider(self.value - self.low),
            high: self.value + wider(self.high - self.value),
        }
    }

    /// The interval moved to another value.
    pub(super) fn centred(&self, value: f64) -> Self {
        Self { value, low: self.low + value - self.value, high: self.high + value - self.value }
    }
}

/// Mean and 95 % interval from the spread of the values; `single` is the half-width for a single value.
pub(super) fn estimate(values: &[f64], single: f64) -> Option<Estimate> {
    let count = values.len() as f64;
    if values.is_empty() {
        return None;
    }
    let value = values.iter().sum::<f64>() / count;
    let half = if values.len() == 1 {
        single
    } else {
        let variance = values.iter().map(|v| (v - value).powi(2)).sum::<f64>() / (count - 1.0);
        student(values.len() - 1) * (variance / count).sqrt()
    };
    Some(Estimate { value, low: value - half, high: value + half })
}

/// Fits of the same lung's cycles, and what their spread does not show.
pub(super) struct Fits {
    /// The fit of each cycle that has a positive compliance.
    pub(super) each: Vec<Solution<COEFFICIENTS>>,
    /// The same from every second row.
    thinned: Vec<Solution<COEFFICIENTS>>,
    /// Share of the residual that all cycles have in common, from 0 to 1: it does not average out.
    common: f64,
}

impl Fits {
    pub(super) fn new(cycles: &[&Cycle], path: &FlowPath) -> Self {
        let fits = |cycle: &Cycle| cycle.fit(FitSpan::Cycle, Drift::Corrected, path);
        let positive = |fit: &Solution<COEFFICIENTS>| fit.coefficients[1] > 0.0;
        Self {
            each: cycles.iter().filter_map(|cycle| fits(cycle)).filter(positive).collect(),
            thinned: cycles.iter().filter_map(|cycle| fits(&cycle.thinned())).filter(positive).collect(),
            common: common(cycles, path),
        }
    }

    /// A coefficient by its place. Its interval has three parts: the spread of the cycles; the uncertainty of a single fit, as far as
    /// the residuals of all cycles are the same; and the change with half of the rows, which shows what the sampling hides.
    pub(super) fn coefficient(&self, place: usize) -> Option<Estimate> {
        let values = |fits: &[Solution<COEFFICIENTS>]| -> Vec<f64> {
            fits.iter().map(|fit| fit.coefficients[place]).collect()
        };
        let single = median(self.each.iter().map(|fit| fit.half_widths[place]).collect());
        let found = estimate(&values(&self.each), single)?;
        let sampling =
            estimate(&values(&self.thinned), 0.0).map_or(0.0, |thinned| thinned.value - found.value);
        Some(found.widened(self.common * single).widened(sampling))
    }

    /// Root mean square of the residuals, cmH2O.
    pub(super) fn residual(&self) -> f64 {
        let square: f64 = self.each.iter().map(|fit| fit.residual.powi(2)).sum();
        (square / self.each.len().max(1) as f64).sqrt()
    }
}

/// A coefficient as an inverse: the compliance from the elastance.
pub(super) fn inverse(elastance: &Estimate) -> Estimate {
    let positive = |elastance: f64| if elastance > 0.0 { 1.0 / elastance } else { f64::MAX };
    Estimate { value: 1.0 / elastance.value, low: 1.0 / elastance.high, high: positive(elastance.low) }
}

/// Root mean square of the cycles' mean residual, as a share of that of their residuals.
pub(super) fn common(cycles: &[&Cycle], path: &FlowPath) -> f64 {
    let left: Vec<Vec<f64>> = cycles.iter().filter_map(|cycle| cycle.left(path)).collect();
    let rows = left.iter().map(Vec::len).min().unwrap_or(0);
    let count = left.len() as f64;
    let mean = |row: usize| left.iter().map(|left| left[row]).sum::<f64>() / count;
    let shared: f64 = (0..rows).map(|row| mean(row).powi(2)).sum();
    let all: f64 = left.iter().flat_map(|left| &left[..rows]).map(|e| e * e).sum::<f64>() / count;
    if all > 0.0 { (shared / all).sqrt() } else { 0.0 }
}
