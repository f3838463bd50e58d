//! Configuration of a simulator's fit.

use engine::adam::AdamConfig;
use serde::{Deserialize, Serialize};

/// Breaths per gradient step of the state-space model: on 160 breaths of the default lung, 16 instead of 64 reduce the
/// open-loop distance from 0.26 to 0.18 cmH2O in the same number of epochs.
pub(crate) const BATCH: usize = 16;
/// Number of gradient steps after which that distance falls only slowly.
pub(crate) const STEPS: usize = 10_000;

/// Configuration of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitConfig {
    /// Number of passes over the training episodes.
    pub epochs: usize,
    /// Episodes per gradient step (rounded up to whole shards).
    pub batch: usize,
    /// Error above which the loss grows linearly, cmH2O; below, it is a parabola, which averages noise.
    pub huber: f32,
    /// Settings of the optimiser.
    pub adam: AdamConfig,
    /// Seed of the initial parameters and of shuffling.
    pub seed: u64,
}

impl Default for FitConfig {
    fn default() -> Self {
        Self {
            epochs: 2500,
            batch: 32,
            huber: 0.3,
            adam: AdamConfig { rate: 5e-3, ..AdamConfig::default() },
            seed: 0,
        }
    }
}

impl FitConfig {
    /// The authors' optimiser settings for their architecture.
    pub fn authors() -> Self {
        let adam = AdamConfig { rate: 1e-3, final_share: 1.0, weight_decay: 1e-4, clip: 1e9 };
        Self { epochs: 500, batch: 64, huber: 0.01, adam, seed: 0 }
    }
}
