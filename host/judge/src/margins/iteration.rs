//! Certificate of iterative learning control.
//!
//! After each breath the feed-forward f becomes `Q [f + g e(t + lead)]`, where e is the breath's error, g the learning gain and Q a
//! zero-phase triangle. At a frequency, each breath multiplies what is wrong with f by `Q (1 - L P S)` with `L = g exp(jw lead)`:
//! below one it dies out from breath to breath, above one it grows until something limits it.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};
use shared::breath::period_s;

use super::complex::Complex;
use super::response::ResponsePoint;

/// A learning rule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearningFilter {
    /// Learning gain, percent per cmH2O.
    pub gain: f64,
    /// Time by which the correction precedes the error, s.
    pub lead_s: f64,
    /// Half of the triangle's base, s; 0 for no smoothing.
    pub half_base_s: f64,
}

impl Default for LearningFilter {
    fn default() -> Self {
        Self { gain: 2.0, lead_s: 0.05, half_base_s: 0.015 }
    }
}

/// Factor on an error from breath to breath at one frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contraction {
    /// Frequency, Hz.
    pub hz: f64,
    /// abs(Q (1 - L P S)).
    pub factor: f64,
}

impl LearningFilter {
    /// Response of the triangle, which has no phase, at a frequency in Hz and a control period in microseconds. Its weights fall
    /// linearly from the centre and reach zero one tick beyond its base.
    pub fn smoothing(&self, hz: f64, period_us: u32) -> f64 {
        let period = f64::from(period_s(period_us));
        let half = (self.half_base_s / period).round() as i32;
        let weight = |tick: i32| f64::from(half + 1 - tick.abs());
        let (mut sum, mut total) = (0.0, 0.0);
        for tick in -half..=half {
            sum += weight(tick) * (TAU * hz * period * f64::from(tick)).cos();
            total += weight(tick);
        }
        sum / total
    }

    /// The factors at the frequencies of a measured loop of the underlying law.
    pub fn contraction(&self, response: &[ResponsePoint], period_us: u32) -> Vec<Contraction> {
        let factor = |point: &ResponsePoint| {
            let learning = Complex::turn(TAU * point.hz * self.lead_s).times(self.gain);
            let rest = Complex::ONE - learning * point.path;
            Contraction { hz: point.hz, factor: self.smoothing(point.hz, period_us).abs() * rest.abs() }
        };
        response.iter().map(factor).collect()
    }

    /// The largest factor over all loops; none without a response.
    pub fn worst<'a>(
        &self,
        responses: impl Iterator<Item = &'a [ResponsePoint]>,
        period_us: u32,
    ) -> Option<Contraction> {
        let factors = responses.flat_map(|response| self.contraction(response, period_us));
        factors.max_by(|one, other| one.factor.total_cmp(&other.factor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pure delay, s, with this gain, cmH2O per percent.
    fn delay(gain: f64, delay_s: f64) -> Vec<ResponsePoint> {
        (1..=40)
            .map(|hz| {
                let path = Complex::turn(-TAU * f64::from(hz) * delay_s).times(gain);
                ResponsePoint { hz: f64::from(hz), loop_gain: Complex::ONE, path }
            })
            .collect()
    }

    #[test]
    fn a_lead_that_makes_up_for_the_delay_leaves_one_minus_the_gains() {
        let filter = LearningFilter { gain: 2.0, lead_s: 0.03, half_base_s: 0.0 };
        for point in filter.contraction(&delay(0.4, 0.03), 1000) {
            assert!((point.factor - 0.2).abs() < 1e-9, "{point:?}");
        }
    }

    #[test]
    fn a_lead_that_is_wrong_by_half_a_period_adds_up() {
        let filter = LearningFilter { gain: 2.0, lead_s: 0.03, half_base_s: 0.0 };
        let worst = filter.worst([delay(0.4, 0.08).as_slice()].into_iter(), 1000).unwrap();
        assert!((worst.factor - 1.8).abs() < 1e-9 && (worst.hz - 10.0).abs() < 1e-9, "{worst:?}");
        assert_eq!(filter.worst(std::iter::empty(), 1000), None);
    }

    #[test]
    fn the_triangle_passes_slow_errors_and_stops_fast_ones() {
        let filter = LearningFilter::default();
        let at = |hz| filter.smoothing(hz, 1000);
        assert!((at(0.0) - 1.0).abs() < 1e-12);
        // The response of a triangle is that of a box, squared.
        for hz in [5.0_f64, 20.0, 40.0] {
            let x = TAU * hz * 0.016 / 2.0;
            assert!((at(hz) - (x.sin() / x).powi(2)).abs() < 2e-3, "{hz}");
        }
        assert!(
            (filter.smoothing(5.0, 1000) - filter.smoothing(5.0, 5000)).abs() < 0.02,
            "{}",
            filter.smoothing(5.0, 5000)
        );
    }
}
