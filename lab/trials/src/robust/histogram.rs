//! Counts of values in narrow bins, from which quantiles are read.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Width of a bin: cmH2O for pressures, no unit for ratios.
const WIDTH: f64 = 0.01;
/// Bins; higher values count in the last one, so memory is bounded.
const BINS: u32 = 10_000;

/// Counts of values of at least 0.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Histogram(BTreeMap<u32, u64>);

/// Values below which a share of all values lies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    /// 1 %.
    pub p1: f64,
    /// 5 %.
    pub p5: f64,
    /// 25 %.
    pub p25: f64,
    /// 50 %.
    pub median: f64,
    /// 75 %.
    pub p75: f64,
    /// 95 %.
    pub p95: f64,
    /// 99 %.
    pub p99: f64,
    /// 99.9 %.
    pub p999: f64,
}

impl Histogram {
    /// Counts a value.
    pub fn add(&mut self, value: f64) {
        *self.0.entry(((value / WIDTH) as u32).min(BINS - 1)).or_default() += 1;
    }

    /// Adds the counts of another histogram.
    pub fn absorb(&mut self, other: Self) {
        for (bin, count) in other.0 {
            *self.0.entry(bin).or_default() += count;
        }
    }

    /// The value below which this share lies, to the upper end of its bin; 0 without values.
    pub fn quantile(&self, share: f64) -> f64 {
        let reached = self.cumulative().into_iter().find(|(_, below)| *below >= share);
        reached.map_or(0.0, |(value, _)| value)
    }

    /// The usual quantiles; none without values.
    pub fn quantiles(&self) -> Option<Quantiles> {
        let [p1, p5, p25, median, p75, p95, p99, p999] =
            [0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 0.999].map(|share| self.quantile(share));
        (!self.0.is_empty()).then_some(Quantiles { p1, p5, p25, median, p75, p95, p99, p999 })
    }

    /// Upper end of every bin that has values, and the share of the values up to it.
    pub fn cumulative(&self) -> Vec<(f64, f64)> {
        let all = self.0.values().sum::<u64>() as f64;
        let mut below = 0;
        let step = |(bin, count): (&u32, &u64)| {
            below += count;
            (f64::from(bin + 1) * WIDTH, below as f64 / all)
        };
        self.0.iter().map(step).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: impl IntoIterator<Item = f64>) -> Histogram {
        let mut histogram = Histogram::default();
        values.into_iter().for_each(|value| histogram.add(value));
        histogram
    }

    #[test]
    fn a_quantile_is_the_upper_end_of_the_bin_that_completes_the_share() {
        let found = of((0..100).map(|value| f64::from(value) + 0.005));
        for (share, wanted) in [(0.01, 0.01), (0.5, 49.01), (0.99, 98.01), (1.0, 99.01)] {
            assert!((found.quantile(share) - wanted).abs() < 1e-9, "{share}: {}", found.quantile(share));
        }
        let quantiles = found.quantiles().unwrap();
        assert!((quantiles.p25 - 24.01).abs() < 1e-9 && (quantiles.p999 - 99.01).abs() < 1e-9);
    }

    #[test]
    fn values_beyond_the_last_bin_count_in_it() {
        let found = of([0.0, 1e9, f64::INFINITY]);
        assert_eq!(found.cumulative(), [(0.01, 1.0 / 3.0), (100.0, 1.0)]);
    }

    #[test]
    fn without_values_there_are_no_quantiles() {
        assert_eq!((of([]).quantile(0.5), of([]).quantiles()), (0.0, None));
    }
}
