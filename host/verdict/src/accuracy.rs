//! Accuracy of a pressure as manufacturers declare it: ±(A cmH2O + B % of the set pressure).

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The accuracy that manufacturers usually declare, and the tolerance of this project's tests.
pub const USUAL: Band = Band { fixed: 2.0, percent: 4.0 };
/// Step to which a declared number is rounded up.
const STEP: f64 = 0.1;

/// A tolerance: a pressure, and a share of the set pressure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// A, cmH2O.
    pub fixed: f64,
    /// B, percent of the set pressure.
    pub percent: f64,
}

impl Band {
    /// Allowed error at a set pressure, cmH2O.
    pub fn at(&self, set: f64) -> f64 {
        self.fixed + 0.01 * self.percent * set.abs()
    }
}

impl fmt::Display for Band {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "±({} cmH2O + {} %)", Tenths(self.fixed), Tenths(self.percent))
    }
}

/// A number with at most one decimal.
pub(super) struct Tenths(pub(super) f64);

impl fmt::Display for Tenths {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.fract() == 0.0 { write!(f, "{:.0}", self.0) } else { write!(f, "{:.1}", self.0) }
    }
}

/// The text is not a tolerance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("write A,B in cmH2O and percent of the set pressure, such as 2,4")]
pub struct NoBand;

impl FromStr for Band {
    type Err = NoBand;

    fn from_str(text: &str) -> Result<Self, NoBand> {
        let number = |text: &str| {
            text.trim()
                .parse::<f64>()
                .ok()
                .filter(|number| *number >= 0.0 && number.is_finite())
                .ok_or(NoBand)
        };
        let (fixed, percent) = text.split_once(',').ok_or(NoBand)?;
        Ok(Self { fixed: number(fixed)?, percent: number(percent)? })
    }
}

/// Errors at the end of one phase, over many breaths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PhaseAccuracy {
    /// Number of breaths.
    pub breaths: usize,
    /// Largest absolute error, cmH2O.
    pub largest: f64,
    /// The tightest ±(A + B %) that covers all breaths: of all that do, the one that allows the smallest error on
    /// average over the breaths, rounded up to a tenth. With one set pressure, B is 0.
    pub declared: Band,
    /// Largest error as a share of the [`USUAL`] tolerance at its set pressure; above 1 it is exceeded.
    pub of_usual: f64,
}

/// The accuracy that covers all pairs of set pressure and absolute error, cmH2O; `None` without pairs.
pub(super) fn accuracy(errors: &[(f64, f64)]) -> Option<PhaseAccuracy> {
    let largest = errors.iter().map(|(_, error)| *error).reduce(f64::max)?;
    let shares = errors.iter().map(|(set, error)| error / USUAL.at(*set));
    let band = tightest(errors);
    let up = |value: f64| (value / STEP - 1e-9).ceil().max(0.0) / (1.0 / STEP);
    Some(PhaseAccuracy {
        breaths: errors.len(),
        largest,
        declared: Band { fixed: up(band.fixed), percent: up(band.percent) },
        of_usual: shares.fold(0.0, f64::max),
    })
}

/// The band that covers all pairs and has the smallest mean: it passes through one edge of their upper hull, or through
/// a corner with A or B at 0.
fn tightest(errors: &[(f64, f64)]) -> Band {
    let mean = errors.iter().map(|(set, _)| set).sum::<f64>() / errors.len() as f64;
    let hull = upper_hull(errors);
    let highest = hull.iter().map(|(_, error)| *error).fold(0.0, f64::max);
    let steepest =
        hull.iter().filter(|(set, _)| *set > 0.0).map(|(set, error)| error / set).fold(0.0, f64::max);
    let flat = (highest, 0.0);
    let edges = hull.windows(2).map(|pair| {
        let slope = (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0);
        (pair[0].1 - slope * pair[0].0, slope)
    });
    let through_zero = hull.iter().all(|(set, _)| *set > 0.0).then_some((0.0, steepest));
    let candidates = edges.chain(through_zero).filter(|(fixed, slope)| *fixed >= 0.0 && *slope > 0.0);
    let cost = |(fixed, slope): (f64, f64)| fixed + slope * mean;
    // A share of the set pressure must be worth more than a rounding error.
    let best = candidates.fold(flat, |best, next| if cost(next) < cost(best) - 1e-9 { next } else { best });
    Band { fixed: best.0, percent: 100.0 * best.1 }
}

/// Corners of the upper convex hull, from left to right.
fn upper_hull(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut hull: Vec<(f64, f64)> = Vec::new();
    for point in sorted {
        while let Some(last) = hull.last().copied() {
            let same = last.0 >= point.0;
            let below = hull.len().checked_sub(2).map(|n| hull[n]).is_some_and(|first| {
                (last.1 - first.1) * (point.0 - first.0) <= (point.1 - first.1) * (last.0 - first.0)
            });
            if !(same || below) {
                break;
            }
            hull.pop();
        }
        hull.push(point);
    }
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn errors_on_a_line_are_declared_as_that_line() {
        let line: Vec<_> = [10.0, 20.0, 35.0].map(|set: f64| (set, 0.5 + 0.02 * set)).into();
        let found = accuracy(&line).unwrap();
        assert_eq!(found.declared, Band { fixed: 0.5, percent: 2.0 });
        assert!((found.largest - 1.2).abs() < 1e-12);
        assert!((found.of_usual - 1.2 / 3.4).abs() < 1e-12);
    }

    #[test]
    fn one_set_pressure_gives_no_share() {
        let found = accuracy(&[(20.0, 0.31), (20.0, 1.24)]).unwrap();
        assert_eq!(found.declared, Band { fixed: 1.3, percent: 0.0 });
    }

    #[test]
    fn errors_that_fall_with_the_set_pressure_give_no_share() {
        let found = accuracy(&[(10.0, 2.0), (35.0, 0.4)]).unwrap();
        assert_eq!(found.declared, Band { fixed: 2.0, percent: 0.0 });
    }

    #[test]
    fn errors_in_proportion_to_the_set_pressure_give_a_share_only() {
        let found = accuracy(&[(10.0, 0.3), (30.0, 0.9), (20.0, 0.1)]).unwrap();
        assert_eq!(found.declared, Band { fixed: 0.0, percent: 3.0 });
    }

    #[test]
    fn nothing_gives_nothing() {
        assert_eq!(accuracy(&[]), None);
        assert_eq!(accuracy(&[(0.0, 0.0)]).unwrap().declared, Band { fixed: 0.0, percent: 0.0 });
    }

    #[test]
    fn a_band_is_typed_as_two_numbers() {
        assert_eq!("2,4".parse(), Ok(USUAL));
        assert_eq!(USUAL.to_string(), "±(2 cmH2O + 4 %)");
        assert_eq!(Band { fixed: 0.25, percent: 0.0 }.to_string(), "±(0.2 cmH2O + 0 %)");
        for wrong in ["2", "2,", "-1,4", "2,NaN", "2,inf", "2;4"] {
            assert_eq!(wrong.parse::<Band>(), Err(NoBand), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn the_declared_band_covers_every_breath_and_none_with_a_smaller_mean_does(
            errors in prop::collection::vec((0.0..60.0_f64, 0.0..9.0_f64), 1..40),
            fixed in 0.0..9.0_f64,
            percent in 0.0..40.0_f64,
        ) {
            let declared = accuracy(&errors).unwrap().declared;
            for (set, error) in &errors {
                prop_assert!(*error <= declared.at(*set) + 1e-9, "{declared:?} {set} {error}");
            }
            let mean = |band: &Band| errors.iter().map(|(set, _)| band.at(*set)).sum::<f64>() / errors.len() as f64;
            let other = Band { fixed, percent };
            if errors.iter().all(|(set, error)| *error <= other.at(*set)) {
                prop_assert!(mean(&tightest(&errors)) <= mean(&other) + 1e-6);
            }
        }
    }
}
