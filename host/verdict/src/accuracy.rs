//! Accuracy of a pressure as manufacturers declare it: ±(A cmH2O + B % of the set pressure).

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The accuracy that manufacturers usually declare, and the tolerance of this project's tests.
pub const USUAL: Band = Band { fixed: 2.0, percent: 4.0 };
/// Relative difference below which two bounds are equal.
const TIE: f64 = 1e-9;
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
    let band = tightest(errors)?;
    let up = |value: f64| (value / STEP - 1e-9).ceil().max(0.0) / (1.0 / STEP);
    Some(PhaseAccuracy {
        breaths: errors.len(),
        largest,
        declared: Band { fixed: up(band.fixed), percent: up(band.percent) },
        of_usual: shares.fold(0.0, f64::max),
    })
}

/// The band that covers all pairs of target and absolute error: of all that do, the one with the smallest mean over the pairs. Targets
/// are not negative. None without a pair, or if a number is not finite.
pub fn tightest(errors: &[(f64, f64)]) -> Option<Band> {
    if errors.is_empty() || errors.iter().any(|(target, error)| !(target.is_finite() && error.is_finite())) {
        return None;
    }
    let mut errors = errors.to_vec();
    errors.sort_by(|one, other| one.0.total_cmp(&other.0).then(one.1.total_cmp(&other.1)));
    let mean = errors.iter().map(|(target, _)| target).sum::<f64>() / errors.len() as f64;
    let hull = upper_hull(&errors);
    let through_zero = hull.iter().filter(|(target, _)| *target > 0.0).map(|(target, error)| error / target);
    let edges = hull.windows(2).map(|edge| (edge[1].1 - edge[0].1) / (edge[1].0 - edge[0].0));
    // The mean bound is convex in the slope, with its corners at these slopes.
    let mut slopes: Vec<f64> =
        edges.chain(through_zero).filter(|slope| *slope > 0.0 && slope.is_finite()).collect();
    slopes.sort_by(f64::total_cmp);
    let bound = |slope: f64| {
        let fixed = hull.iter().map(|(target, error)| error - slope * target).fold(0.0, f64::max);
        (fixed + slope * mean, Band { fixed, percent: 100.0 * slope })
    };
    // Of equal bounds, the one with the smaller share: of a single target, the absolute one.
    let better =
        |best: (f64, Band), other: (f64, Band)| if other.0 < best.0 * (1.0 - TIE) { other } else { best };
    Some(slopes.into_iter().map(bound).fold(bound(0.0), better).1)
}

/// Corners of the upper hull of points that are sorted by their first coordinate.
fn upper_hull(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut hull: Vec<(f64, f64)> = Vec::new();
    for point in points {
        while let [.., before, last] = hull[..] {
            let turn =
                (last.0 - before.0) * (point.1 - before.1) - (last.1 - before.1) * (point.0 - before.0);
            if turn < 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(*point);
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
                prop_assert!(mean(&tightest(&errors).unwrap()) <= mean(&other) + 1e-6);
            }
        }
    }
}
