//! What several files ask of a series of values: its mean over neighbours, its reversals, extremes and median.

/// Mean over `reach` samples on either side, fewer at the ends.
pub(crate) fn averaged(values: &[f64], reach: usize) -> Vec<f64> {
    let mut sums = vec![0.0; values.len() + 1];
    for (n, value) in values.iter().enumerate() {
        sums[n + 1] = sums[n] + value;
    }
    let mean = |n: usize| {
        let reach = reach.min(n).min(values.len() - 1 - n);
        (sums[n + reach + 1] - sums[n - reach]) / (2 * reach + 1) as f64
    };
    (0..values.len()).map(mean).collect()
}

/// Extremes from which the curve, rising at first, moves back by at least `band`; and the last extreme.
pub(crate) fn reversals(values: &[f64], band: f64) -> (Vec<usize>, usize) {
    let (mut found, mut extreme, mut up) = (Vec::new(), 0, true);
    for (n, value) in values.iter().enumerate() {
        let beyond = if up { value - values[extreme] } else { values[extreme] - value };
        if beyond > 0.0 {
            extreme = n;
        } else if -beyond >= band {
            found.push(extreme);
            (extreme, up) = (n, !up);
        }
    }
    (found, extreme)
}

/// Place of the highest value, the first of equal ones; 0 if there is none.
pub(crate) fn highest(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, n| if values[n] > values[best] { n } else { best })
}

/// Place of the lowest value, the first of equal ones; 0 if there is none.
pub(crate) fn lowest(values: impl Iterator<Item = f64>) -> usize {
    values.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(place, _)| place)
}

/// Median, the upper one of an even number; 0 without values.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
