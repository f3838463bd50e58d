//! `AdamW` (Loshchilov and Hutter 2019) with clipping of the gradient's norm and a cosine schedule.

use serde::{Deserialize, Serialize};

/// Settings of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AdamConfig {
    /// Initial learning rate.
    pub rate: f32,
    /// Share of the learning rate at the end of the schedule.
    pub final_share: f32,
    /// Weight decay per unit of learning rate.
    pub weight_decay: f32,
    /// Largest norm of a gradient; longer ones are scaled down.
    pub clip: f32,
}

impl Default for AdamConfig {
    fn default() -> Self {
        Self { rate: 3e-3, final_share: 0.02, weight_decay: 1e-4, clip: 1.0 }
    }
}

const BETA: (f32, f32) = (0.9, 0.999);
const EPSILON: f32 = 1e-8;

/// State of the optimiser.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Adam {
    config: AdamConfig,
    mean: Vec<f32>,
    square: Vec<f32>,
    steps: u32,
}

impl Adam {
    /// An optimiser of `parameters` parameters.
    pub fn new(config: AdamConfig, parameters: usize) -> Self {
        Self { config, mean: vec![0.0; parameters], square: vec![0.0; parameters], steps: 0 }
    }

    /// One step along the gradient; `progress` is the completed share of the schedule, 0 to 1. Returns the gradient's
    /// norm. A gradient that is not finite is skipped, because it would ruin parameters and state.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], progress: f32) -> f32 {
        let norm = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
        if !norm.is_finite() {
            return norm;
        }
        self.steps += 1;
        let scale = if norm > self.config.clip { self.config.clip / norm } else { 1.0 };
        let rate = self.rate(progress);
        let steps = self.steps as i32;
        let correction = (1.0 - BETA.0.powi(steps), 1.0 - BETA.1.powi(steps));
        let moments = self.mean.iter_mut().zip(&mut self.square);
        for ((parameter, gradient), (mean, square)) in parameters.iter_mut().zip(gradient).zip(moments) {
            let gradient = gradient * scale;
            *mean += (1.0 - BETA.0) * (gradient - *mean);
            *square += (1.0 - BETA.1) * (gradient * gradient - *square);
            let direction = (*mean / correction.0) / ((*square / correction.1).sqrt() + EPSILON);
            *parameter -= rate * (direction + self.config.weight_decay * *parameter);
        }
        norm
    }

    fn rate(&self, progress: f32) -> f32 {
        let cosine = 0.5 * (1.0 + (std::f32::consts::PI * progress.clamp(0.0, 1.0)).cos());
        self.config.rate * (self.config.final_share + (1.0 - self.config.final_share) * cosine)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadratic_bowl_is_descended_to_its_bottom() {
        let mut parameters = vec![3.0, -2.0, 0.5];
        let bottom = [1.0, 1.0, 1.0];
        let config = AdamConfig { rate: 0.05, weight_decay: 0.0, ..AdamConfig::default() };
        let mut adam = Adam::new(config, 3);
        for step in 0..600 {
            let gradient: Vec<f32> = parameters.iter().zip(bottom).map(|(p, b)| p - b).collect();
            adam.step(&mut parameters, &gradient, step as f32 / 600.0);
        }
        assert!(parameters.iter().all(|p| (p - 1.0).abs() < 1e-2), "{parameters:?}");
    }

    #[test]
    fn a_broken_gradient_changes_nothing() {
        let mut parameters = vec![1.0];
        let norm = Adam::new(AdamConfig::default(), 1).step(&mut parameters, &[f32::NAN], 0.0);
        assert!(norm.is_nan());
        assert!((parameters[0] - 1.0).abs() < f32::EPSILON);
    }

    #[test]
    fn decay_pulls_weights_to_zero() {
        let config = AdamConfig { rate: 0.1, weight_decay: 0.5, ..AdamConfig::default() };
        let mut parameters = vec![1.0];
        Adam::new(config, 1).step(&mut parameters, &[0.0], 0.0);
        assert!((parameters[0] - 0.95).abs() < 1e-6);
    }
}
