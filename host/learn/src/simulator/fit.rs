//! Fitting a simulator to a recording.
//!
//! Our architectures are trained on the task that they are used for: open-loop rollouts over whole inspirations, with
//! the start of the breath and the recorded commands as inputs and every pressure as output. The authors' architecture
//! is trained in their way, on single steps from measured pressures.

use std::ops::Range;

use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;

use super::episode::Episode;
use super::model::{Architecture, Model, Simulator};
use super::open_loop::mean;
use super::rollout::Rollout;
use super::shard::Shard;
use engine::adam::{Adam, AdamConfig};
use engine::{LANES, huber};
use progress::Stage;

/// Fitting simulators: epochs.
pub const FIT: Stage = Stage("fit simulators");

pub use super::fit_config::FitConfig;

/// Parameters that are trained together.
#[derive(Debug)]
struct ParameterGroup {
    range: Range<usize>,
    adam: Adam,
    /// Share of the epochs in which they are trained.
    share: f32,
}

impl ParameterGroup {
    /// The groups of an architecture.
    fn of(architecture: &Architecture, adam: AdamConfig) -> Vec<Self> {
        let group =
            |(range, share): (Range<usize>, f32)| Self { adam: Adam::new(adam, range.len()), range, share };
        architecture.groups().into_iter().map(group).collect()
    }

    /// One optimiser step, if the group is still being trained.
    fn step(&mut self, parameters: &mut [f32], gradient: &[f32], progress: f32) {
        if progress < self.share {
            let range = self.range.clone();
            self.adam.step(&mut parameters[range.clone()], &gradient[range], progress / self.share);
        }
    }
}

/// Summed loss and its gradient.
#[derive(Clone, Debug)]
struct Gradient {
    loss: f64,
    count: f64,
    by_parameter: Vec<f32>,
}

/// State of a fit that can be advanced, observed and stopped at every epoch.
#[derive(Debug)]
pub struct Fit<'a> {
    architecture: Architecture,
    config: FitConfig,
    episodes: Vec<&'a Episode>,
    parameters: Vec<f32>,
    groups: Vec<ParameterGroup>,
    rng: ChaCha8Rng,
    epoch: usize,
}

impl<'a> Fit<'a> {
    /// Starts from given parameters (a warm start) or random ones.
    pub fn new(
        architecture: Architecture,
        episodes: &[&'a Episode],
        config: FitConfig,
        warm: Option<&Simulator>,
    ) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let fresh = architecture.initialise(&mut rng);
        let parameters = warm
            .filter(|simulator| simulator.architecture == architecture)
            .map_or(fresh, |simulator| simulator.parameters.clone());
        let groups = ParameterGroup::of(&architecture, config.adam);
        Self { architecture, config, episodes: episodes.to_vec(), parameters, groups, rng, epoch: 0 }
    }

    /// Runs one pass over the episodes; returns the mean loss, or `None` when all epochs are done.
    pub fn epoch(&mut self) -> Option<f64> {
        if self.epoch >= self.config.epochs || self.episodes.is_empty() {
            return None;
        }
        self.episodes.shuffle(&mut self.rng);
        let batch = self.config.batch.div_ceil(LANES) * LANES;
        let batches = self.episodes.len().div_ceil(batch);
        let (mut loss, mut count) = (0.0, 0.0);
        for (n, episodes) in self.episodes.chunks(batch).enumerate() {
            let model = Model::new(self.architecture, &self.parameters);
            let gradient = batch_gradient(&model, episodes, self.config.huber);
            let mean: Vec<f32> =
                gradient.by_parameter.iter().map(|g| g / gradient.count.max(1.0) as f32).collect();
            let progress = (self.epoch as f32 + n as f32 / batches as f32) / self.config.epochs as f32;
            for group in &mut self.groups {
                group.step(&mut self.parameters, &mean, progress);
            }
            loss += gradient.loss;
            count += gradient.count;
        }
        self.epoch += 1;
        Some(loss / count.max(1.0))
    }

    /// The present simulator, with the properties of the recording that its users need.
    pub fn simulator(&self, plant: &str) -> Simulator {
        let starts = self.episodes.iter().map(|e| f64::from(e.start));
        Simulator {
            architecture: self.architecture,
            parameters: self.parameters.clone(),
            noise: noise(&self.episodes),
            start_pressure: mean(starts) as f32,
            plant: plant.to_owned(),
        }
    }
}

/// Loss and gradient of a batch; shards run in parallel and are summed in their order. A shard takes as long as its longest episode,
/// so episodes of about the same length share one.
fn batch_gradient(model: &Model, episodes: &[&Episode], bound: f32) -> Gradient {
    let mut episodes = episodes.to_vec();
    episodes.sort_by_key(|episode| episode.ticks());
    sum(Shard::cut(&episodes).par_iter().map(|shard| shard_gradient(model, shard, bound)).collect())
}

fn sum(parts: Vec<Gradient>) -> Gradient {
    let mut parts = parts.into_iter();
    let Some(mut total) = parts.next() else {
        return Gradient { loss: 0.0, count: 0.0, by_parameter: Vec::new() };
    };
    for part in parts {
        total.loss += part.loss;
        total.count += part.count;
        for (total, part) in total.by_parameter.iter_mut().zip(part.by_parameter) {
            *total += part;
        }
    }
    total
}

/// Huber loss against the measured pressure at every tick except the first, and its gradient.
fn shard_gradient(model: &Model, shard: &Shard<'_>, bound: f32) -> Gradient {
    let mut rollout = Rollout::replay(model, shard, true);
    let (mut loss, mut count) = (0.0, 0.0);
    for tick in 1..shard.ticks() {
        let error = rollout.pressure_at(tick).zip(&shard.pressure(tick), |p, measured| p - measured);
        let weight = shard.weight(tick);
        loss += f64::from(error.zip(&weight, |e, w| w * huber::value(e, bound)).sum());
        count += f64::from(weight.sum());
        rollout.add_pressure_gradient(tick, &error.zip(&weight, |e, w| w * huber::slope(e, bound)));
    }
    let mut by_parameter = vec![0.0; model.architecture().parameters()];
    rollout.replay_back(&mut by_parameter);
    Gradient { loss, count, by_parameter }
}

/// Standard deviation of the sensor noise, from third differences, which are small for a smooth pressure.
pub fn noise(episodes: &[&Episode]) -> f32 {
    let third = |p: &[f32]| f64::from(p[3] - 3.0 * p[2] + 3.0 * p[1] - p[0]);
    let square = mean(episodes.iter().flat_map(|e| e.pressure.windows(4).map(third)).map(|d| d * d));
    // Binomial coefficients 1, 3, 3, 1: the variances add up to 20.
    (square / 20.0).sqrt() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::hybrid::HybridConfig;
    use crate::simulator::tests_support::episode;

    #[test]
    fn physics_of_many_lungs_are_kept_after_their_share_of_the_epochs() {
        let shape = HybridConfig { ventilators: 1, groups: 2, ..HybridConfig::for_period(10_000, 1) };
        let breath = |group: u32| Episode {
            commands: vec![0.5 + 0.1 * group as f32; 20],
            group: Some(group),
            ventilator: Some(0),
            ..episode(20)
        };
        let breaths = [breath(0), breath(1)];
        let config = FitConfig { epochs: 10, ..FitConfig::default() };
        let mut fit = Fit::new(Architecture::Hybrid(shape), &breaths.each_ref(), config, None);
        let mut after = |epochs: usize| {
            (0..epochs).for_each(|_| assert!(fit.epoch().unwrap() > 0.0));
            let (physics, rest) = fit.parameters.split_at(shape.physics().end);
            (physics.to_vec(), rest.to_vec())
        };
        let (first, share, end) = (after(1), after(1), after(8));
        assert_ne!(first.0, share.0, "physics learn");
        assert_eq!(share.0, end.0, "and are kept");
        assert_ne!(share.1, end.1, "while what they leave over goes on");
    }
}
