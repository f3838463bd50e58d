//! The rise of a pressure: its length, and whether it is straight, as a rise-time setting makes it.

use engine::least_squares::solve;
use monitoring::curve::{RISE, rise};

/// Shortest ramp, s: shorter ones cannot be told from the lag of a valve.
const SHORTEST_S: f64 = 0.15;
/// Largest distance (rms) of a straight rise from its line, as a share of the way: that of an exponential one is 8 %.
const STRAIGHT: f64 = 0.02;
/// The same in standard deviations of the noise.
const STRAIGHT_NOISE: f64 = 1.5;
/// Rise of a target as a share of the pressure's, up to which the pressure's ramp is not the target's.
const OF_ITS_OWN: f64 = 0.5;

/// The rise of a pressure from one level to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ramp {
    /// Its whole length and its end, s, extrapolated from the part between 10 and 90 % of the way.
    pub length_s: f64,
    pub end_s: f64,
    /// Whether it is as straight and as long as that of a rise-time setting.
    pub straight: bool,
}

impl Ramp {
    /// The rise of a curve over the way between two pressures; `noise` is its standard deviation. `None` if it does not
    /// get to 90 % of the way.
    pub fn new(pressure: &[f64], way: (f64, f64), period_s: f64, noise: f64) -> Option<Self> {
        let (start, end) = rise(pressure, way, period_s)?;
        let length_s = (end - start) / (RISE.1 - RISE.0);
        let first = (start / period_s).ceil() as usize;
        let part = &pressure[first..((end / period_s).ceil() as usize).max(first)];
        let straight = length_s >= SHORTEST_S
            && distance(part)
                .is_some_and(|rms| rms <= (STRAIGHT * (way.1 - way.0)).max(STRAIGHT_NOISE * noise));
        Some(Self { length_s, end_s: end + (1.0 - RISE.1) * length_s, straight })
    }

    /// Whether this is the straight rise of a pressure whose target, with this rise, asks for a much shorter one.
    pub fn is_own(&self, target: &Self) -> bool {
        self.straight && target.length_s <= OF_ITS_OWN * self.length_s
    }
}

/// Distance (rms) of a curve from the line through it.
fn distance(values: &[f64]) -> Option<f64> {
    let rows: Vec<[f64; 2]> = (0..values.len()).map(|n| [1.0, n as f64]).collect();
    let [level, slope] = solve(&rows, values)?.coefficients;
    let square = |(row, value): (&[f64; 2], &f64)| (value - level - slope * row[1]).powi(2);
    Some((rows.iter().zip(values).map(square).sum::<f64>() / values.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(curve: impl Fn(f64) -> f64) -> Ramp {
        let pressure: Vec<f64> = (0..1000).map(|n| curve(f64::from(n) * 1e-3)).collect();
        Ramp::new(&pressure, (5.0, 25.0), 1e-3, 0.0).unwrap()
    }

    #[test]
    fn a_straight_rise_has_its_length_and_end() {
        let found = ramp(|t| (5.0 + 50.0 * (t - 0.05).max(0.0)).min(25.0));
        assert!(found.straight, "{found:?}");
        assert!((found.length_s - 0.4).abs() < 1e-6 && (found.end_s - 0.45).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn a_lag_and_a_step_are_no_ramp() {
        assert!(!ramp(|t| 25.0 - 20.0 * (-t / 0.1).exp()).straight);
        assert!(!ramp(|t| if t < 0.1 { 5.0 } else { 25.0 }).straight);
    }

    #[test]
    fn a_ramp_that_the_target_asks_for_is_not_the_pressures_own() {
        let (slow, square) = (ramp(|t| (5.0 + 50.0 * t).min(25.0)), ramp(|_| 25.0));
        assert!(slow.is_own(&square) && !slow.is_own(&slow) && !square.is_own(&square));
    }
}
