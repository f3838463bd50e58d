//! Declared accuracy: the smallest `+-(A + B %)` around the target that holds for a set of measurements.

mod bench;

pub use bench::{Declared, PhaseEnd, Setup, declared, measure};

use serde::{Deserialize, Serialize};
use verdict::tightest;

/// A target with what was measured, in the same unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The target.
    pub target: f64,
    /// The measured value.
    pub value: f64,
}

/// An accuracy of `+-(absolute + percent / 100 * target)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// A, in the unit of the target.
    pub absolute: f64,
    /// B, percent of the target.
    pub percent: f64,
}

impl Accuracy {
    /// The smallest accuracy that holds for all measurements: see [`tightest`]. Targets are not negative. None without a measurement, or
    /// if one is not finite.
    pub fn declared(measurements: &[Measured]) -> Option<Self> {
        let error = |Measured { target, value }: &Measured| (*target, (value - target).abs());
        let band = tightest(&measurements.iter().map(error).collect::<Vec<_>>())?;
        Some(Self { absolute: band.fixed, percent: band.percent })
    }

    /// Bound at a target.
    pub fn at(&self, target: f64) -> f64 {
        self.absolute + self.percent / 100.0 * target
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn declared(errors: &[(f64, f64)]) -> Accuracy {
        let measured: Vec<_> = errors
            .iter()
            .map(|(target, error)| Measured { target: *target, value: target + error })
            .collect();
        Accuracy::declared(&measured).unwrap()
    }

    fn assert_is(accuracy: Accuracy, absolute: f64, percent: f64) {
        assert!((accuracy.absolute - absolute).abs() < 1e-9, "{accuracy:?}");
        assert!((accuracy.percent - percent).abs() < 1e-9, "{accuracy:?}");
    }

    #[test]
    fn errors_that_grow_with_the_target_are_a_share_of_it() {
        assert_is(declared(&[(10.0, 0.2), (20.0, -0.4), (40.0, 0.8)]), 0.0, 2.0);
    }

    #[test]
    fn equal_errors_are_absolute() {
        assert_is(declared(&[(10.0, 0.5), (20.0, -0.5), (40.0, 0.5), (30.0, 0.1)]), 0.5, 0.0);
        assert_is(declared(&[(5.0, 0.1), (5.0, -0.3)]), 0.3, 0.0);
    }

    #[test]
    fn both_parts_together_touch_the_worst_errors() {
        assert_is(declared(&[(10.0, 0.7), (20.0, -0.9), (40.0, 1.3), (30.0, 0.2)]), 0.5, 2.0);
    }

    #[test]
    fn errors_that_shrink_with_the_target_do_not_make_a_negative_share() {
        assert_is(declared(&[(10.0, 0.8), (20.0, 0.4), (40.0, 0.2)]), 0.8, 0.0);
    }

    #[test]
    fn nothing_measured_declares_nothing() {
        assert_eq!(Accuracy::declared(&[]), None);
        assert_eq!(Accuracy::declared(&[Measured { target: 10.0, value: f64::NAN }]), None);
    }

    proptest! {
        #[test]
        fn the_declared_accuracy_holds_and_no_other_has_a_smaller_mean_bound(
            errors in prop::collection::vec((0.0..50.0_f64, -3.0..3.0_f64), 1..30),
            absolute in 0.0..3.0_f64,
        ) {
            let found = declared(&errors);
            prop_assert!(errors.iter().all(|(target, error)| error.abs() <= found.at(*target) + 1e-9));
            // The best slope beside any other absolute part.
            let slope = errors.iter().map(|(target, error)| (error.abs() - absolute) / target).fold(0.0, f64::max);
            let other = Accuracy { absolute, percent: 100.0 * slope };
            let mean = |of: &Accuracy| errors.iter().map(|(target, _)| of.at(*target)).sum::<f64>();
            prop_assert!(mean(&found) <= mean(&other) + 1e-6);
        }
    }
}
