//! Certificate of iterative learning control.
//!
//! After each breath the feed-forward f becomes `Q [f + g e(t + lead)]`, where e is the breath's error, g the learning gain and Q a
//! zero-phase triangle. At a frequency, each breath multiplies what is wrong with f by `Q (1 - L P S)`: below one it dies out from
//! breath to breath, above one it grows until something limits it. `L = g exp(jw lead)` is the learning, P the plant from command to
//! pressure, S the sensitivity of the loop underneath, so that `P S` leads from the feed-forward to the pressure. The ends of a breath,
//! where the triangle is cut, are not covered.

use std::f64::consts::TAU;

use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use shared::breath::period_s;

use super::{OSCILLATES_CMH2O, PlantMargins};
use tuning::response::ResponsePoint;

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
            let learning = Complex64::cis(TAU * point.hz * self.lead_s) * self.gain;
            let rest = Complex64::ONE - learning * point.path;
            Contraction { hz: point.hz, factor: self.smoothing(point.hz, period_us).abs() * rest.norm() }
        };
        response.iter().map(factor).collect()
    }

    /// The largest factor of a plant at each frequency, over its loops, which were measured at the same frequencies.
    fn envelope<'a>(
        &self,
        responses: impl Iterator<Item = &'a [ResponsePoint]>,
        period_us: u32,
    ) -> Vec<Contraction> {
        let curves = responses.map(|response| self.contraction(response, period_us));
        let larger = |one, other| worst([one, other].iter()).unwrap_or(one);
        let highest = |one: Vec<Contraction>, other: Vec<Contraction>| {
            one.into_iter().zip(other).map(|(one, other)| larger(one, other)).collect()
        };
        curves.reduce(highest).unwrap_or_default()
    }
}

/// The certificate of a learning rule on some plants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// The rule.
    pub filter: LearningFilter,
    /// The largest factor of all plants.
    pub worst: Option<Contraction>,
    /// Share of the plants that are certified.
    pub share_certified: f64,
    /// Every plant, in the given order.
    pub plants: Vec<Certified>,
}

/// The factors on a plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Certified {
    /// Name of the plant.
    pub plant: String,
    /// Whether the factor is below one at every frequency and no loop oscillates by itself, which would spoil the measurement.
    pub certified: bool,
    /// The largest factor; none if no frequency was measured.
    pub worst: Option<Contraction>,
    /// The largest factor of all its operating points, by frequency.
    pub curve: Vec<Contraction>,
}

/// Factors at one frequency, over plants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Frequency, Hz.
    pub hz: f64,
    /// Factor that half of the plants do not exceed.
    pub median: f64,
    /// Factor that 95 % of them do not exceed.
    pub most: f64,
    /// Their largest factor.
    pub largest: f64,
}

impl Certificate {
    /// The certificate of a rule on measured plants, for a control period in microseconds.
    pub fn of(filter: LearningFilter, plants: &[PlantMargins], period_us: u32) -> Self {
        let certified = |plant: &PlantMargins| {
            let responses = plant.points.iter().map(|point| &point.response[..]);
            let curve = filter.envelope(responses, period_us);
            let worst = worst(curve.iter());
            let steady = plant.points.iter().all(|point| point.rest_sd_cmh2o <= OSCILLATES_CMH2O);
            let certified = steady && worst.is_some_and(|at| at.factor < 1.0);
            Certified { plant: plant.plant.clone(), certified, worst, curve }
        };
        let plants: Vec<Certified> = plants.iter().map(certified).collect();
        let count = plants.iter().filter(|plant| plant.certified).count();
        Self {
            filter,
            worst: worst(plants.iter().filter_map(|plant| plant.worst.as_ref())),
            share_certified: count as f64 / plants.len().max(1) as f64,
            plants,
        }
    }

    /// How the factors spread over the plants, by frequency.
    pub fn spread(&self) -> Vec<Spread> {
        let frequencies = self.plants.iter().map(|plant| plant.curve.len()).min().unwrap_or(0);
        let at = |place: usize| {
            let mut factors: Vec<f64> = self.plants.iter().map(|plant| plant.curve[place].factor).collect();
            factors.sort_by(f64::total_cmp);
            let quantile = |share: f64| factors[((share * factors.len() as f64).ceil() as usize).max(1) - 1];
            let hz = self.plants[0].curve[place].hz;
            Spread { hz, median: quantile(0.5), most: quantile(0.95), largest: quantile(1.0) }
        };
        (0..frequencies).map(at).collect()
    }
}

/// The largest factor. One that is no number is larger than any other.
fn worst<'a>(factors: impl Iterator<Item = &'a Contraction>) -> Option<Contraction> {
    factors.copied().max_by(|one, other| one.factor.abs().total_cmp(&other.factor.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MeasuredPoint;
    use crate::operating_point::OperatingPoint;

    /// A pure delay, s, with this gain, cmH2O per percent.
    fn delay(gain: f64, delay_s: f64) -> Vec<ResponsePoint> {
        (1..=40)
            .map(|hz| {
                let path = Complex64::cis(-TAU * f64::from(hz) * delay_s) * gain;
                ResponsePoint { hz: f64::from(hz), loop_gain: Complex64::ONE, path }
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
        let worst = worst(filter.contraction(&delay(0.4, 0.08), 1000).iter()).unwrap();
        assert!((worst.factor - 1.8).abs() < 1e-9 && (worst.hz - 10.0).abs() < 1e-9, "{worst:?}");
    }

    /// A plant with a pure delay of 30 ms at each operating point, with these gains.
    fn plant(name: &str, gains: &[f64]) -> PlantMargins {
        let point = |gain: &f64| MeasuredPoint {
            point: OperatingPoint { pip: 20.0, peep: 5.0, flow_l_s: 0.2 },
            rest_sd_cmh2o: 0.1,
            margins: None,
            doubled: None,
            limited: 0.0,
            response: delay(*gain, 0.03),
        };
        PlantMargins {
            plant: name.to_owned(),
            points: gains.iter().map(point).collect(),
            worst: None,
            pid: None,
        }
    }

    #[test]
    fn a_plant_is_certified_if_its_worst_operating_point_is_below_one() {
        let filter = LearningFilter { gain: 2.0, lead_s: 0.03, half_base_s: 0.0 };
        // Factors abs(1 - 2 gain): 0.2 and 0.6; 0.2 and 1.4; 0.8.
        let plants = [plant("a", &[0.4, 0.2]), plant("b", &[0.4, 1.2]), plant("c", &[0.1])];
        let found = Certificate::of(filter, &plants, 1000);
        assert!((found.share_certified - 2.0 / 3.0).abs() < 1e-12);
        let factors: Vec<f64> = found.plants.iter().map(|plant| plant.worst.unwrap().factor).collect();
        assert!(factors.iter().zip([0.6, 1.4, 0.8]).all(|(found, wanted)| (found - wanted).abs() < 1e-9));
        assert!((found.worst.unwrap().factor - 1.4).abs() < 1e-9);
        for at in found.spread() {
            assert!((at.median - 0.8).abs() < 1e-9 && (at.most - 1.4).abs() < 1e-9, "{at:?}");
            assert!((at.largest - 1.4).abs() < 1e-9);
        }
        assert_eq!(found.spread().len(), 40);
    }

    #[test]
    fn a_plant_without_a_response_is_not_certified() {
        let found = Certificate::of(LearningFilter::default(), &[plant("a", &[])], 1000);
        assert!(found.share_certified < 1e-12 && found.worst.is_none() && found.spread().is_empty());
        assert_eq!(Certificate::of(LearningFilter::default(), &[], 1000).plants.len(), 0);
    }

    #[test]
    fn a_plant_whose_loop_oscillates_by_itself_is_not_certified() {
        let mut oscillating = plant("a", &[0.2]);
        oscillating.points[0].rest_sd_cmh2o = 1.1;
        let found = Certificate::of(LearningFilter::default(), &[oscillating, plant("b", &[0.2])], 1000);
        let certified: Vec<bool> = found.plants.iter().map(|plant| plant.certified).collect();
        assert_eq!(certified, [false, true]);
    }

    #[test]
    fn a_factor_that_is_no_number_is_the_worst_and_certifies_nothing() {
        let found = Certificate::of(LearningFilter::default(), &[plant("a", &[0.2, f64::NAN])], 1000);
        assert!(found.share_certified < 1e-12 && found.worst.unwrap().factor.is_nan(), "{found:?}");
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
