//! Configuration of a controller's training.

use engine::adam::AdamConfig;
use serde::{Deserialize, Serialize};
use shared::breath::PAPER_PIPS;

use super::efforts::EffortConfig;

/// Configuration of a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Number of gradient steps.
    pub iterations: usize,
    /// Inspirations per gradient step (rounded up to whole shards).
    pub batch: usize,
    /// PIPs of the waveforms in every shard and in the validation, cmH2O.
    pub pips: Vec<f32>,
    /// Range of the random PIPs that fill up a shard, cmH2O.
    pub pip_range: (f32, f32),
    /// PEEP (positive end-expiratory pressure), cmH2O.
    pub peep: f32,
    /// Command before the inspiration, percent.
    pub rest: f32,
    /// Inspiratory time, s.
    pub inspiratory_time: f32,
    /// Factor on errors above the target.
    pub overshoot_weight: f32,
    /// Standard deviation of the starting pressure, cmH2O.
    pub start_spread: f32,
    /// Standard deviation of the sensor noise, cmH2O; `None` uses the estimate from the simulators' recordings, which
    /// requires a control period far shorter than the changes of the pressure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor_noise: Option<f32>,
    /// Efforts of breathing patients; `None` trains on passive ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub efforts: Option<EffortConfig>,
    /// Weight of each plant, if there are several.
    pub weighting: Weighting,
    /// Features hidden from the network, by their index in [`shared::control::features`], to measure what a feature
    /// contributes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub blind_to: Vec<usize>,
    /// Gradient steps between validations.
    pub validate_every: usize,
    /// Settings of the optimiser.
    pub adam: AdamConfig,
    /// Seed of initial weights, PIPs and noise.
    pub seed: u64,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            iterations: 600,
            batch: 64,
            pips: PAPER_PIPS.to_vec(),
            pip_range: (8.0, 37.0),
            peep: 5.0,
            rest: 5.0,
            inspiratory_time: 1.0,
            overshoot_weight: 1.0,
            start_spread: 0.05,
            sensor_noise: None,
            efforts: None,
            weighting: Weighting::Sum,
            blind_to: Vec::new(),
            validate_every: 25,
            adam: AdamConfig { rate: 4e-3, final_share: 0.02, weight_decay: 1e-4, clip: 1.0 },
            seed: 0,
        }
    }
}

impl TrainConfig {
    /// The default on breathing patients: their breaths differ more, and take twice the gradient steps to learn.
    pub fn breathing() -> Self {
        let passive = Self::default();
        Self { iterations: 2 * passive.iterations, efforts: Some(EffortConfig::default()), ..passive }
    }
}

/// How each plant's error is weighted in the loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weighting {
    /// Equal weights: minimises the mean score.
    #[default]
    Sum,
    /// By the softmax of the scores over this temperature, cmH2O, as in the paper: emphasises the worst score.
    Softmax(f64),
}

impl Weighting {
    /// Factors with a mean of one, from the plants' last scores.
    pub(super) fn factors(self, scores: &[f64]) -> Vec<f32> {
        let Self::Softmax(temperature) = self else { return vec![1.0; scores.len()] };
        let highest = scores.iter().copied().fold(f64::MIN, f64::max);
        let powers: Vec<f64> = scores.iter().map(|score| ((score - highest) / temperature).exp()).collect();
        let mean = powers.iter().sum::<f64>() / powers.len() as f64;
        powers.iter().map(|power| (power / mean) as f32).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_plant_weighs_most_and_the_mean_weight_is_one() {
        let factors = Weighting::Softmax(0.5).factors(&[1.0, 2.0, 1.0]);
        assert!(factors[1] > 5.0 * factors[0], "{factors:?}");
        assert!((factors.iter().sum::<f32>() - 3.0).abs() < 1e-5);
        assert_eq!(Weighting::Sum.factors(&[1.0, 2.0]), [1.0, 1.0]);
        let far_apart = Weighting::Softmax(0.1).factors(&[0.0, 1e6]);
        assert!(far_apart.iter().all(|factor| factor.is_finite()), "{far_apart:?}");
    }
}
