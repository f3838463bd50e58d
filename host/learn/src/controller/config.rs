//! Configuration of a controller's training: on the simulators of single plants, and for a family of units.

use engine::adam::AdamConfig;
use plant::prescriptions::Prescriptions;
use serde::{Deserialize, Serialize};
use shared::breath::PAPER_PIPS;

use super::efforts::EffortConfig;

/// Usual price of moving the valve once the pressure should have settled, cmH2O per percent of change per tick. On R20C20 it lowers the
/// valve effort of the plateau from 3825 to 804 %/s, below the 2233 %/s of the best PID, for a score of 0.934 in place of 0.931 cmH2O.
pub const EFFORT_PRICE: f32 = 0.02;

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
    /// Price of moving the valve once the pressure should have settled, cmH2O per percent of change per tick; 0 is the paper's plain
    /// distance.
    pub effort_price: f32,
    /// Prescriptions to draw in every second shard and in half of the validation, in place of these waveforms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prescriptions: Option<Prescriptions>,
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
            effort_price: 0.0,
            prescriptions: None,
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

/// What an oracle tells the controller of its unit. Every breath is then the first of its course.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Told {
    /// Nothing, to compare with.
    Nothing,
    /// Dead time, lag, play, dead zone, curve and full flow of the machine.
    Machine,
    /// Resistance and compliance of the lung too.
    Unit,
    /// All of them, but only from the 50th tick of the breath on: no student that learns within a breath knows them earlier.
    Student,
    /// Nothing, but the network keeps a state of its own through the breath: a student that can be built.
    Recurrent,
}

/// Configuration of the training for a family.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FamilyConfig {
    /// Number of gradient steps.
    pub iterations: usize,
    /// Inspirations per gradient step (rounded up to whole shards).
    pub batch: usize,
    /// What the controller is trained for.
    pub prescriptions: Prescriptions,
    /// Waveforms that it is judged on by default: those of the paper, or of the family.
    pub usual: Prescriptions,
    /// Share of the shards with these waveforms; most of their courses have any PIP that can be set.
    pub usual_share: f32,
    /// Range of the standard deviation of the sensor noise, cmH2O.
    pub noise: (f32, f32),
    /// Largest amplitude of a sine late in the inspiration, cmH2O, in the reading of the pressure or in the pressure itself. A controller
    /// that follows a sine in its reading is close to oscillating; one that amplifies a sine in the pressure has a large Ms. Training
    /// without such a ripple leaves it with small stability margins.
    pub ripple: f32,
    /// Range of the frequency of a sine in the reading, Hz: around and above the crossover of the loop.
    pub ripple_hz: (f32, f32),
    /// Share of the breaths whose sine is in the pressure itself.
    pub pressure_ripple_share: f32,
    /// Range of its frequency, Hz: mostly above the crossover. A slower one a controller would learn to cancel, with a higher gain.
    pub pressure_ripple_hz: (f32, f32),
    /// Standard deviation of the starting pressure, cmH2O.
    pub start_spread: f32,
    /// Probability that a course ends after a breath.
    pub restart_probability: f32,
    /// Probability that the lung changes after a breath.
    pub lung_change_probability: f32,
    /// Factors on the errors of the first breaths of a course, of which little is remembered; later breaths have the factor 1.
    pub early_weights: [f32; 2],
    /// Share of the breaths in which the loop is strained once the pressure should have settled: less or more gain, or more dead time, by
    /// turns. So it learns to keep margins.
    pub strain_share: f32,
    /// Additional dead time of a strained loop, s.
    pub strain_delay: f32,
    /// Number of plateaus on which the margins are measured in a gradient step, as a share of the batch.
    pub plateau_share: f32,
    /// Price of a sensitivity of one above its bound, cmH2O.
    pub margin_price: f32,
    /// What an oracle tells the controller.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub told: Option<Told>,
    /// Factor on an overshoot beyond a tenth of the driving pressure.
    pub overshoot_weight: f32,
    /// Price of moving the valve once the pressure should have settled, cmH2O per percent of change per tick.
    pub effort_price: f32,
    /// Price of holding the valve back while the pressure is far below its target, long after it should have reached it, cmH2O of error per
    /// percent.
    pub restraint_price: f32,
    /// Gradient steps between validations.
    pub validate_every: usize,
    /// Settings of the optimiser.
    pub adam: AdamConfig,
    /// Seed of initial weights, courses and noise.
    pub seed: u64,
}

impl Default for FamilyConfig {
    fn default() -> Self {
        Self {
            iterations: 42_000,
            batch: 256,
            prescriptions: Prescriptions::default(),
            usual: Prescriptions::default(),
            usual_share: 0.45,
            noise: (0.05, 0.2),
            ripple: 1.2,
            ripple_hz: (1.5, 12.0),
            pressure_ripple_share: 0.5,
            pressure_ripple_hz: (3.0, 20.0),
            start_spread: 0.05,
            restart_probability: 0.12,
            lung_change_probability: 0.03,
            early_weights: [4.0, 2.0],
            strain_share: 0.3,
            strain_delay: 0.01,
            plateau_share: 0.2,
            margin_price: 12.0,
            told: None,
            overshoot_weight: 6.0,
            effort_price: EFFORT_PRICE,
            restraint_price: 0.05,
            validate_every: 100,
            adam: AdamConfig { rate: 3e-3, final_share: 0.02, weight_decay: 1e-4, clip: 1.0 },
            seed: 0,
        }
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
