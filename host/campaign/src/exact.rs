//! Sums that do not depend on the order in which values are added.

use serde::{Deserialize, Serialize};

/// A sum of floating-point values that is the same in any order and in any parts, to the last bit.
///
/// It is a fixed-point number with 64 binary digits behind the point, and 63 before it: what a value has beyond the 64th is cut off,
/// 5e-20 at most. Values that are not finite, or larger than 1e15, are counted apart: with one of them the sum is not a number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "(String, u64)", try_from = "(String, u64)")]
pub struct ExactSum {
    /// In units of 2^-64; written as text, because JSON's numbers are too small for it.
    sum: i128,
    /// Values that cannot be added.
    unknown: u64,
}

/// One, in fixed point.
const ONE: f64 = 18_446_744_073_709_551_616.0;
/// Largest value; ten thousand of them can be added.
const LARGEST: f64 = 1e15;

impl ExactSum {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        // Written so that NaN is unknown too.
        let known = value.abs() <= LARGEST;
        let sum = if known { (value * ONE) as i128 } else { 0 };
        self.absorb(Self { sum, unknown: u64::from(!known) });
    }

    /// Adds another sum.
    pub fn absorb(&mut self, other: Self) {
        // Wrapping, because saturation would depend on the order.
        self.sum = self.sum.wrapping_add(other.sum);
        self.unknown += other.unknown;
    }

    /// The sum as a floating-point number; NaN if a value could not be added.
    pub fn value(self) -> f64 {
        if self.unknown == 0 { self.sum as f64 / ONE } else { f64::NAN }
    }
}

impl From<ExactSum> for (String, u64) {
    fn from(sum: ExactSum) -> Self {
        (sum.sum.to_string(), sum.unknown)
    }
}

impl TryFrom<(String, u64)> for ExactSum {
    type Error = std::num::ParseIntError;

    fn try_from((text, unknown): (String, u64)) -> Result<Self, Self::Error> {
        Ok(Self { sum: text.parse()?, unknown })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: impl IntoIterator<Item = f64>) -> ExactSum {
        let mut sum = ExactSum::default();
        values.into_iter().for_each(|value| sum.add(value));
        sum
    }

    #[test]
    fn the_order_of_the_values_does_not_matter() {
        let values: Vec<f64> =
            (1..2000).map(|n| (f64::from(n) * 0.37).sin() * 10_f64.powi(n % 7 - 3)).collect();
        let forward = of(values.iter().copied());
        assert_eq!(forward, of(values.iter().rev().copied()));
        let (one, other) = values.split_at(700);
        let (mut parts, other) = (of(other.iter().copied()), of(one.iter().copied()));
        parts.absorb(other);
        assert_eq!(forward, parts);
        let floating = |values: &[f64]| values.iter().sum::<f64>().to_bits();
        let reversed: Vec<f64> = values.iter().rev().copied().collect();
        assert_ne!(floating(&values), floating(&reversed), "ordinary sums differ: these values tell");
        assert!((forward.value() - values.iter().sum::<f64>()).abs() < 1e-9);
    }

    #[test]
    fn a_sum_is_written_and_read_without_loss() {
        for sum in [of([0.1, -0.3]), of([1e15, 1e-12]), of([f64::INFINITY]), of([f64::NAN])] {
            let text = serde_json::to_string(&sum).unwrap();
            assert_eq!(serde_json::from_str::<ExactSum>(&text).unwrap(), sum, "{text}");
        }
        assert!(serde_json::from_str::<ExactSum>("[\"much\", 0]").is_err());
    }

    #[test]
    fn a_value_that_is_no_number_is_not_lost() {
        for value in [f64::NAN, f64::INFINITY, -1e300] {
            assert!(of([1.0, value, 2.0]).value().is_nan(), "{value}");
        }
        assert!((of([1e15, -1e15, 2.5]).value() - 2.5).abs() < 1e-12);
    }
}
