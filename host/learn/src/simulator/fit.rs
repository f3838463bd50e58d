//! Fitting a simulator to a recording, and judging it by open-loop distance.
//!
//! Our architecture is trained on what it is used for: open-loop rollouts over whole inspirations, the start of
//! the breath and the recorded commands in, every pressure out. The authors' is trained as they do, on one step
//! at a time from measured pressures. Figures come from
//! episodes held out of training.

use std::collections::BTreeMap;
use std::ops::Range;

use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::episode::{Episode, Shard};
use super::model::{Architecture, Model, Simulator};
use super::stitched::Stitched;
use super::{COMMAND_SCALE, CommandLog, Dynamics, Timing};
use engine::adam::{Adam, AdamConfig};
use engine::{LANES, Lane};

/// How to fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitConfig {
    /// Passes over the training episodes.
    pub epochs: usize,
    /// Episodes per gradient step (rounded up to whole shards).
    pub batch: usize,
    /// Error beyond which the loss grows linearly, cmH2O; below it is a parabola, which averages the noise out.
    pub huber: f32,
    /// Optimiser.
    pub adam: AdamConfig,
    /// Seed of initial parameters and shuffling.
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
    /// The authors' optimiser for their architecture.
    pub fn authors() -> Self {
        let adam = AdamConfig { rate: 1e-3, final_share: 1.0, weight_decay: 1e-4, clip: 1e9 };
        Self { epochs: 500, batch: 64, huber: 0.01, adam, seed: 0 }
    }
}

/// Share of the epochs after which a simulator of many lungs keeps its physics and only goes on with what they leave over.
/// With longer physics the measured lungs that were held out came out worse (docs/RECORDINGS.md).
const SETTLED: f32 = 0.2;

/// Parameters that learn together.
#[derive(Debug)]
struct Part {
    range: Range<usize>,
    adam: Adam,
    /// Share of the epochs in which they learn.
    share: f32,
}

impl Part {
    /// The parts of an architecture.
    fn of(architecture: &Architecture, adam: AdamConfig) -> Vec<Self> {
        let part = |range: Range<usize>, share| Self { adam: Adam::new(adam, range.len()), range, share };
        let all = architecture.parameters();
        match architecture {
            Architecture::Hybrid(shape) => {
                let physics = shape.physics();
                vec![part(physics.clone(), SETTLED), part(physics.end..all, 1.0)]
            }
            Architecture::StateSpace(_) | Architecture::Stitched(_) => vec![part(0..all, 1.0)],
        }
    }

    /// One step of those that still learn.
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

/// How a simulator does on episodes it has not seen; mean absolute errors in cmH2O.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OpenLoop {
    /// Error of the predicted change of pressure over one simulator step, against the measured change.
    pub one_step: f64,
    /// Open-loop distance to the measured pressure, noise included.
    pub measured: f64,
    /// Open-loop distance to the true airway pressure, where a bench knows it.
    pub truth: Option<f64>,
}

/// Open-loop distance by waveform.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ByWaveform {
    /// PIP, cmH2O.
    pub pip: f32,
    /// Episodes with this PIP.
    pub episodes: usize,
    /// Errors on them.
    pub open_loop: OpenLoop,
}

/// State of a fit that can be advanced, watched and stopped at every epoch.
#[derive(Debug)]
pub struct Fit<'a> {
    architecture: Architecture,
    config: FitConfig,
    episodes: Vec<&'a Episode>,
    parameters: Vec<f32>,
    parts: Vec<Part>,
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
        let fresh = match &architecture {
            Architecture::StateSpace(shape) => shape.initialise(&mut rng),
            Architecture::Hybrid(shape) => shape.initialise(&mut rng),
            Architecture::Stitched(shape) => shape.initialise(&mut rng),
        };
        let parameters = warm
            .filter(|simulator| simulator.architecture == architecture)
            .map_or(fresh, |simulator| simulator.parameters.clone());
        let parts = Part::of(&architecture, config.adam);
        Self { architecture, config, episodes: episodes.to_vec(), parameters, parts, rng, epoch: 0 }
    }

    /// One pass over the episodes; the mean loss, or none when all epochs are done.
    pub fn epoch(&mut self) -> Option<f64> {
        if self.epoch >= self.config.epochs || self.episodes.is_empty() {
            return None;
        }
        self.episodes.shuffle(&mut self.rng);
        let batch = self.config.batch.div_ceil(LANES) * LANES;
        let batches = self.episodes.len().div_ceil(batch);
        let (mut loss, mut count) = (0.0, 0.0);
        for (n, episodes) in self.episodes.chunks(batch).enumerate() {
            let model = Simulator::model_of(self.architecture, &self.parameters);
            let gradient = batch_gradient(&model, episodes, self.config.huber);
            let mean: Vec<f32> =
                gradient.by_parameter.iter().map(|g| g / gradient.count.max(1.0) as f32).collect();
            let progress = (self.epoch as f32 + n as f32 / batches as f32) / self.config.epochs as f32;
            for part in &mut self.parts {
                part.step(&mut self.parameters, &mean, progress);
            }
            loss += gradient.loss;
            count += gradient.count;
        }
        self.epoch += 1;
        Some(loss / count.max(1.0))
    }

    /// The simulator as it is now, with what else its users need to know of the recording.
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

/// Loss and gradient of a batch; shards in parallel, summed in their order.
fn batch_gradient(model: &Model, episodes: &[&Episode], huber: f32) -> Gradient {
    let shards = Shard::cut(episodes);
    let parts: Vec<Gradient> = shards
        .par_iter()
        .map(|shard| match model {
            Model::StateSpace(model) => rollout_gradient(model, shard, huber),
            Model::Hybrid(model) => rollout_gradient(model, shard, huber),
            Model::Stitched(model) => one_step_gradient(model, shard, huber),
        })
        .collect();
    sum(parts)
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

/// Huber's loss of one lane of errors and its slope, weighted.
fn huber_loss(error: &Lane, weight: &Lane, bound: f32) -> (f32, Lane) {
    let slope = error.zip(weight, |e, w| w * (e / bound).clamp(-1.0, 1.0));
    let value = error.zip(weight, |e, w| {
        let e = e.abs();
        w * if e < bound { 0.5 * e * e / bound } else { e - 0.5 * bound }
    });
    (value.sum(), slope)
}

/// An open-loop rollout: the pressure at each tick, from which [`Self::back`] leads back to the parameters.
struct Rollout<'m, M: Dynamics> {
    model: &'m M,
    tape: M::Tape,
    /// Pressure at the start of the breath, then at the points of each block.
    points: Vec<Lane>,
    ticks: usize,
}

impl<'m, M: Dynamics> Rollout<'m, M> {
    fn run(model: &'m M, shard: &Shard<'_>) -> Self {
        let timing = model.timing();
        let (ticks, log) = (shard.ticks(), shard.log(timing));
        let blocks = timing.blocks(ticks);
        let mut tape = model.tape(blocks);
        let start = shard.start();
        model.begin(&mut tape, &start);
        let mut points = vec![start.pressure; 1 + blocks * timing.points];
        for block in 0..blocks {
            let place = 1 + block * timing.points;
            model.step(&mut tape, block, &log, &mut points[place..place + timing.points]);
        }
        Self { model, tape, points, ticks }
    }

    /// Block, weights and points between which tick `tick` (1 and later) lies.
    fn place(&self, tick: usize) -> (usize, [f32; 3]) {
        let timing = self.model.timing();
        let block = (tick - 1) / timing.block_ticks;
        (block * timing.points, timing.interpolation(tick - block * timing.block_ticks))
    }

    fn pressure(&self, tick: usize) -> Lane {
        if tick == 0 {
            return self.points[0];
        }
        let (first, weights) = self.place(tick);
        let mut pressure = Lane::ZERO;
        for (point, weight) in self.points[first..].iter().zip(weights) {
            pressure.add_scaled(weight, point);
        }
        pressure
    }

    /// Loss against the measured pressure at every tick but the first, and its gradient.
    fn back(mut self, shard: &Shard<'_>, huber: f32) -> Gradient {
        let timing = *self.model.timing();
        let mut d_points = vec![Lane::ZERO; self.points.len() + 1];
        let (mut loss, mut count) = (0.0, 0.0);
        for tick in 1..self.ticks {
            let error = self.pressure(tick).zip(&shard.pressure(tick), |a, b| a - b);
            let weight = shard.weight(tick);
            let (value, slope) = huber_loss(&error, &weight, huber);
            loss += f64::from(value);
            count += f64::from(weight.sum());
            let (first, weights) = self.place(tick);
            for (d, weight) in d_points[first..].iter_mut().zip(weights) {
                d.add_scaled(weight, &slope);
            }
        }
        let mut d_log = CommandLog::new(timing.blocks(self.ticks), vec![Lane::ZERO; timing.width()]);
        for block in (0..timing.blocks(self.ticks)).rev() {
            let place = 1 + block * timing.points;
            self.model.step_back(&mut self.tape, block, &d_points[place..place + timing.points], &mut d_log);
        }
        let mut by_parameter = vec![0.0; self.model.parameters()];
        self.model.finish(&mut self.tape, &mut by_parameter);
        Gradient { loss, count, by_parameter }
    }
}

fn rollout_gradient<M: Dynamics>(model: &M, shard: &Shard<'_>, huber: f32) -> Gradient {
    Rollout::run(model, shard).back(shard, huber)
}

/// Teacher forcing: every step starts from measured pressures.
fn one_step_gradient(model: &Stitched, shard: &Shard<'_>, huber: f32) -> Gradient {
    let timing = model.timing();
    let (steps, log) = (shard.ticks() - 1, shard.log(timing));
    let mut tape = model.tape(steps);
    model.begin(&mut tape, &shard.start());
    let mut slopes = Vec::with_capacity(steps);
    let (mut loss, mut count, mut point) = (0.0, 0.0, [Lane::ZERO]);
    for step in 0..steps {
        model.step(&mut tape, step, &log, &mut point);
        let measured = shard.pressure(step + 1);
        let weight = shard.weight(step + 1);
        let (value, slope) = huber_loss(&point[0].zip(&measured, |a, b| a - b), &weight, huber);
        loss += f64::from(value);
        count += f64::from(weight.sum());
        slopes.push(slope);
        model.teach(&mut tape, step, &measured);
    }
    let mut d_log = CommandLog::new(timing.blocks(shard.ticks()), vec![Lane::ZERO; timing.width()]);
    for step in (0..steps).rev() {
        model.step_back(&mut tape, step, &slopes[step..=step], &mut d_log);
    }
    let mut by_parameter = vec![0.0; model.parameters()];
    model.finish(&mut tape, &mut by_parameter);
    Gradient { loss, count, by_parameter }
}

/// Pressures that a simulator predicts open loop for each episode, cmH2O per control tick.
pub fn predict(simulator: &Simulator, episodes: &[&Episode]) -> Vec<Vec<f32>> {
    match simulator.model() {
        Model::StateSpace(model) => predict_with(&model, episodes),
        Model::Hybrid(model) => predict_with(&model, episodes),
        Model::Stitched(model) => predict_with(&model, episodes),
    }
}

fn predict_with<M: Dynamics>(model: &M, episodes: &[&Episode]) -> Vec<Vec<f32>> {
    Shard::cut(episodes)
        .par_iter()
        .flat_map_iter(|shard| {
            let rollout = Rollout::run(model, shard);
            let lanes: Vec<Lane> = (0..rollout.ticks).map(|tick| rollout.pressure(tick)).collect();
            let own = |l: usize, e: &Episode| lanes[..e.ticks()].iter().map(|p| p[l]).collect();
            shard.episodes.iter().enumerate().map(|(l, e)| own(l, e)).collect::<Vec<Vec<f32>>>()
        })
        .collect()
}

/// Errors of a simulator on episodes.
pub fn open_loop(simulator: &Simulator, episodes: &[&Episode]) -> OpenLoop {
    let predictions = predict(simulator, episodes);
    let timing = simulator.architecture.timing();
    let distance = |actual: &dyn Fn(&Episode) -> Option<Vec<f32>>| {
        mean(episodes.iter().zip(&predictions).flat_map(|(episode, predicted)| {
            let actual = actual(episode).unwrap_or_default();
            predicted.iter().zip(actual).map(|(p, a)| f64::from((p - a).abs())).collect::<Vec<_>>()
        }))
    };
    let has_truth = episodes.iter().all(|e| e.truth.is_some()) && !episodes.is_empty();
    OpenLoop {
        one_step: one_step(timing, episodes, &predictions),
        measured: distance(&|e| Some(e.pressure.clone())),
        truth: has_truth.then(|| distance(&|e| e.truth.clone())),
    }
}

/// A command this much higher asks a simulator whether it is a plant, percent.
const PROBE: f32 = 5.0;

/// Mean rise of the predicted pressure at these times (s) where every command of the inspiratory valve is five percent
/// of full opening higher, and what the valve had before the breath is as it was; cmH2O.
///
/// A plant answers with a rise. A simulator that has learned to read the pressure from the commands of the recording's
/// controller answers with a fall, because that controller opens the valve where the pressure is low.
pub fn response(simulator: &Simulator, episodes: &[&Episode], times: &[f32]) -> Vec<f64> {
    let timing = simulator.architecture.timing();
    let raised: Vec<Episode> = episodes
        .iter()
        .map(|episode| {
            let mut raised = (*episode).clone();
            let inspiratory = raised.commands.iter_mut().step_by(timing.channels);
            inspiratory.for_each(|command| *command += PROBE / COMMAND_SCALE);
            raised
        })
        .collect();
    let before = predict(simulator, episodes);
    let after = predict(simulator, &raised.iter().collect::<Vec<_>>());
    let rise =
        |time: &f32| {
            let tick = shared::math::ticks(*time, timing.period_us) as usize;
            mean(before.iter().zip(&after).filter_map(|(before, after)| {
                Some(f64::from(*after.get(tick)?) - f64::from(*before.get(tick)?))
            }))
        };
    times.iter().map(rise).collect()
}

/// Errors by PIP, PIPs rising.
pub fn by_waveform(simulator: &Simulator, episodes: &[&Episode]) -> Vec<ByWaveform> {
    let mut pips: Vec<f32> = episodes.iter().map(|e| e.pip).collect();
    pips.sort_by(f32::total_cmp);
    pips.dedup();
    pips.into_iter()
        .map(|pip| {
            let own: Vec<&Episode> =
                episodes.iter().copied().filter(|e| e.pip.total_cmp(&pip).is_eq()).collect();
            ByWaveform { pip, episodes: own.len(), open_loop: open_loop(simulator, &own) }
        })
        .collect()
}

fn one_step(timing: &Timing, episodes: &[&Episode], predictions: &[Vec<f32>]) -> f64 {
    let step = timing.block_ticks;
    mean(episodes.iter().zip(predictions).flat_map(|(episode, predicted)| {
        (step..predicted.len()).step_by(step).map(move |tick| {
            let change = |p: &[f32]| p[tick] - p[tick - step];
            f64::from((change(predicted) - change(&episode.pressure)).abs())
        })
    }))
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    sum / count.max(1) as f64
}

/// Standard deviation of the sensor's noise: from third differences, which a smooth pressure hardly has.
pub fn noise(episodes: &[&Episode]) -> f32 {
    let third = |p: &[f32]| f64::from(p[3] - 3.0 * p[2] + 3.0 * p[1] - p[0]);
    let square = mean(episodes.iter().flat_map(|e| e.pressure.windows(4).map(third)).map(|d| d * d));
    // Binomial coefficients 1, 3, 3, 1: variances add up to 20.
    (square / 20.0).sqrt() as f32
}

/// Splits episodes into those to train on and every `every`-th of each group, held out.
pub fn split(episodes: &[Episode], every: usize) -> (Vec<&Episode>, Vec<&Episode>) {
    let mut before: BTreeMap<Option<u32>, usize> = BTreeMap::new();
    episodes.iter().partition(|episode| {
        let place = before.entry(episode.group).or_default();
        *place += 1;
        !place.is_multiple_of(every.max(2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::USUAL_LUNG;
    use crate::simulator::hybrid::HybridConfig;

    #[test]
    fn physics_of_many_lungs_are_kept_after_their_share_of_the_epochs() {
        let shape = HybridConfig { ventilators: 1, groups: 2, ..HybridConfig::for_period(10_000, 1) };
        let breath = |group: u32| Episode {
            pressure: (0..20).map(|tick| 5.0 + 0.5 * tick as f32).collect(),
            truth: None,
            commands: vec![0.5 + 0.1 * group as f32; 20],
            rest: vec![0.1],
            start: 5.0,
            plateau: 15.0,
            plateau_command: 0.3,
            pip: 15.0,
            peep: 5.0,
            group: Some(group),
            ventilator: Some(0),
            rows: 0..20,
            lung: Some(USUAL_LUNG),
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
