//! Properties of an instrument, estimated from a series of its readings: quantum and noise.

/// Smallest step between values: the most frequent distance between neighbours in size, refined over all distances. 0
/// if all values are equal.
pub fn quantum(values: &[f32]) -> f64 {
    /// Distances below this are rounding errors of the text, which has four decimals.
    const TEXT_STEP: f64 = 2e-4;
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    let mut steps: Vec<f64> = sorted
        .windows(2)
        .map(|pair| f64::from(pair[1]) - f64::from(pair[0]))
        .filter(|&step| step > TEXT_STEP)
        .collect();
    steps.sort_by(f64::total_cmp);
    let same = |a: &f64, b: &f64| (b - a).abs() < 0.5 * TEXT_STEP;
    let Some(common) = steps.chunk_by(same).max_by_key(|chunk| chunk.len()) else {
        return 0.0;
    };
    let guess = common[common.len() / 2];
    let (sum, count) = steps
        .iter()
        .map(|step| (step, (step / guess).round()))
        .filter(|(_, count)| (1.0..=4.0).contains(count))
        .fold((0.0, 0.0), |(sum, all), (step, count)| (sum + step, all + count));
    sum / count
}

/// Ratio of the standard deviation to the median absolute deviation of a normal variable.
pub const SD_PER_DEVIATION: f64 = 1.482_602;

/// Standard deviation of the white noise in a series.
pub fn noise(values: &[f32]) -> f64 {
    let mut bends: Vec<f32> = values.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()).collect();
    noise_of_second_differences(&mut bends)
}

/// Standard deviation of white noise, from the absolute values of its second differences.
///
/// Second differences ignore slopes; the median ignores the rises.
pub fn noise_of_second_differences(second_differences: &mut [f32]) -> f64 {
    /// Ratio of a second difference's standard deviation to the noise's: root of 1 + 4 + 1.
    const SECOND_DIFFERENCE: f64 = 2.449_490;
    second_differences.sort_by(f32::total_cmp);
    let median = second_differences.get(second_differences.len() / 2).copied().unwrap_or(0.0);
    SD_PER_DEVIATION * f64::from(median) / SECOND_DIFFERENCE
}
