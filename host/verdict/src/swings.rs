//! Oscillation: how often and how far the pressure swings after its first peak.

use serde::Serialize;

use super::series::{averaged, reversals};

/// Smallest move of the pressure that counts as a swing, cmH2O.
const SMALLEST: f64 = 0.5;
/// The same as a multiple of the noise's standard deviation: the largest of a breath's samples are that far apart.
const NOISE_BAND: f64 = 8.0;
/// Distance of reversals, as a multiple of their median distance, above which it is a pause.
const PAUSE: f64 = 1.5;
/// Longest time over which noise is averaged out, s; faster swings than 15 Hz would suffer.
const SMOOTHED_S: f64 = 0.03;

/// Swings of one inspiration. A swing is a move in one direction; an oscillation has two of them in each period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Swings {
    /// Number of swings after the first peak; the fall from a single overshoot to the plateau counts as one.
    pub count: usize,
    /// Largest swing, from peak to trough, cmH2O; 0 without swings.
    pub size: f64,
    /// Frequency, Hz, from the mean distance of reversals without pauses. `None` if there are fewer than two reversals.
    pub frequency: Option<f64>,
}

/// Turning points of the pressure from the end of its rise on.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Turns {
    /// Where the pressure turned, from the first peak on.
    reversals: Vec<usize>,
    /// The extreme that the last swing reached.
    last: usize,
    smooth: Vec<f64>,
    period_s: f64,
}

impl Turns {
    /// Finds the turning points of a rising curve; `noise` is its standard deviation, cmH2O.
    pub fn new(pressure: &[f64], period_s: f64, noise: f64) -> Self {
        let wanted = (NOISE_BAND * noise / SMALLEST).powi(2);
        let longest = (SMOOTHED_S / period_s).round().max(1.0);
        let reach = (0.5 * wanted.min(longest)).floor() as usize;
        let smooth = averaged(pressure, reach);
        let band = SMALLEST.max(NOISE_BAND * noise / ((2 * reach + 1) as f64).sqrt());
        let (reversals, last) = reversals(&smooth, band);
        Self { reversals, last, smooth, period_s }
    }

    /// Index of the first peak; `None` if the pressure never turns.
    pub fn first_peak(&self) -> Option<usize> {
        self.reversals.first().copied()
    }

    /// The swings.
    pub fn swings(&self) -> Swings {
        let ends: Vec<usize> = self.reversals.iter().copied().chain([self.last]).collect();
        let sizes = ends.windows(2).map(|pair| (self.smooth[pair[1]] - self.smooth[pair[0]]).abs());
        let frequency = frequency(&self.reversals, self.period_s);
        Swings { count: self.reversals.len(), size: sizes.fold(0.0, f64::max), frequency }
    }
}

/// Frequency of an oscillation with these reversals, Hz: from their mean distance, without pauses such as that before
/// the first swing.
fn frequency(reversals: &[usize], period_s: f64) -> Option<f64> {
    let mut gaps: Vec<usize> = reversals.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_unstable();
    let longest = PAUSE * *gaps.get(gaps.len() / 2)? as f64;
    gaps.retain(|gap| *gap as f64 <= longest);
    let half = gaps.iter().sum::<usize>() as f64 / gaps.len() as f64 * period_s;
    Some(0.5 / half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Swings of one second of a curve.
    fn swings(period_s: f64, noise: f64, curve: impl Fn(f64) -> f64) -> Swings {
        let count = (1.0 / period_s).round() as usize;
        let pressure: Vec<f64> = (0..count).map(|n| curve(n as f64 * period_s)).collect();
        Turns::new(&pressure, period_s, noise).swings()
    }

    #[test]
    fn an_oscillation_has_its_size_frequency_and_two_swings_in_each_period() {
        for period_s in [0.001, 0.01] {
            let found = swings(period_s, 0.0, |t| 20.0 + 1.5 * (TAU * 5.0 * t).sin());
            // The first peak is at 0.05 s; nine reversals follow it.
            assert_eq!(found.count, 10);
            assert!((found.size - 3.0).abs() < 1e-9, "{found:?}");
            assert!((found.frequency.unwrap() - 5.0).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn a_rise_without_a_reversal_has_no_swing() {
        let still = swings(0.001, 0.0, |t| 20.0 * (1.0 - (-t / 0.1).exp()));
        assert_eq!(still, Swings { count: 0, size: 0.0, frequency: None });
    }

    #[test]
    fn an_overshoot_that_decays_is_one_swing() {
        let once =
            swings(0.001, 0.0, |t| if t < 0.1 { 230.0 * t } else { 20.0 + 3.0 * (-(t - 0.1) / 0.05).exp() });
        assert_eq!((once.count, once.frequency), (1, None));
        assert!((once.size - 3.0).abs() < 0.01, "{once:?}");
    }

    #[test]
    fn moves_below_half_a_unit_are_no_swings() {
        let amplitude = |amplitude: f64| swings(0.001, 0.0, |t| amplitude * (TAU * 5.0 * t).sin()).count;
        assert_eq!((amplitude(0.249), amplitude(0.2501)), (0, 9));
    }

    #[test]
    fn noise_makes_no_swings_and_hides_no_oscillation() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, Normal};
        let normal = Normal::new(0.0, 0.25).unwrap();
        for (period_s, expected) in [(0.001, 0), (0.01, 0)] {
            let random = std::cell::RefCell::new(rand_chacha::ChaCha8Rng::seed_from_u64(1));
            let noisy = |wave: f64| {
                swings(period_s, 0.25, |t| {
                    wave * (TAU * 4.0 * t).sin() + normal.sample(&mut *random.borrow_mut())
                })
            };
            assert_eq!(noisy(0.0).count, expected);
            let found = noisy(2.0);
            assert!((found.frequency.unwrap() - 4.0).abs() < 0.2, "{found:?}");
            assert!((found.size - 4.0).abs() < 0.8, "{found:?}");
        }
    }
}
