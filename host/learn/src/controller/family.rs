//! Training one controller for a family of units.
//!
//! Each lane follows a course of breaths on one unit. After a gradient step, the lane remembers the breath just run; with a small
//! probability, it starts a new course on another unit. So the controller trains on first, second and late breaths, with memories
//! that it has made itself. After every validation all courses start again, so that a stopped training continues exactly.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::PAPER_PIPS;
use shared::control::network::Network;
use shared::control::residual::{Residual, ResidualError, ResidualSpec};
use shared::settings::Settings;

use super::courses::Courses;
use super::network::initial_parameters;
use super::rollout::{ClosedLoopTape, LaneController};
use super::training::{Checkpoint, Stepwise, Trained, mean};
use crate::simulator::model::Model;
use engine::adam::{Adam, AdamConfig};
use engine::{LANES, Lane};

/// Configuration of the training for a family.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FamilyConfig {
    /// Number of gradient steps.
    pub iterations: usize,
    /// Inspirations per gradient step (rounded up to whole shards).
    pub batch: usize,
    /// PIPs of half of the courses, cmH2O.
    pub pips: Vec<f32>,
    /// Range of the PIPs of the other half, cmH2O.
    pub pip_range: (f32, f32),
    /// PEEP, cmH2O.
    pub peep: f32,
    /// Command before an inspiration that is not the first, percent.
    pub rest: f32,
    /// Inspiratory time, s.
    pub inspiratory_time: f32,
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
    /// Factor on errors above the target.
    pub overshoot_weight: f32,
    /// Price of moving the valve after the first 40 % of the inspiration, cmH2O per percent of change per tick.
    pub effort_price: f32,
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
            iterations: 12_000,
            batch: 256,
            pips: PAPER_PIPS.to_vec(),
            pip_range: (8.0, 37.0),
            peep: 5.0,
            rest: 5.0,
            inspiratory_time: 1.0,
            noise: (0.05, 0.2),
            ripple: 0.8,
            ripple_hz: (1.5, 12.0),
            pressure_ripple_share: 0.5,
            pressure_ripple_hz: (3.0, 20.0),
            start_spread: 0.05,
            restart_probability: 0.12,
            lung_change_probability: 0.03,
            early_weights: [3.0, 2.0],
            overshoot_weight: 1.0,
            effort_price: 0.02,
            validate_every: 100,
            adam: AdamConfig { rate: 3e-3, final_share: 0.02, weight_decay: 1e-4, clip: 1.0 },
            seed: 0,
        }
    }
}

impl FamilyConfig {
    /// The configuration in breaths with these settings and PIPs, cmH2O; random PIPs go a little beyond them where the settings'
    /// bounds allow it.
    #[must_use]
    pub fn in_breaths(self, settings: &Settings, pips: &[f32]) -> Self {
        let ends =
            pips.iter().fold((f32::INFINITY, 0.0_f32), |(low, high), pip| (low.min(*pip), high.max(*pip)));
        let allowed = |pip: f32| Settings { pip, ..*settings }.validate().is_ok().then_some(pip);
        Self {
            pips: pips.to_vec(),
            pip_range: (
                allowed(ends.0 - BEYOND_CMH2O).unwrap_or(ends.0),
                allowed(ends.1 + BEYOND_CMH2O).unwrap_or(ends.1),
            ),
            peep: settings.peep,
            rest: settings.expiratory_bias,
            inspiratory_time: settings.inspiratory_time,
            ..self
        }
    }
}

/// Distance by which random PIPs go beyond those of the waveforms, cmH2O.
const BEYOND_CMH2O: f32 = 2.0;
/// Shards and breaths of a validation.
const VALIDATION: (usize, u32) = (8, 6);
/// Number of the random stream for validation; training uses the numbers of its steps.
const VALIDATION_STREAM: u64 = 1 << 62;

/// Units of a family as simulators.
#[derive(Clone, Debug)]
pub struct FamilyModels {
    /// Units to train on.
    pub trained_on: Model,
    /// Units to validate on.
    pub held_out: Model,
}

/// A training that can be advanced step by step, observed, stopped and resumed.
#[derive(Debug)]
pub struct FamilyTraining {
    config: FamilyConfig,
    base: Residual,
    ticks: usize,
    models: FamilyModels,
    courses: Vec<Courses>,
    tapes: Vec<ClosedLoopTape>,
    base_score: f64,
    state: Checkpoint,
}

impl FamilyTraining {
    /// Prepares the training of the residual of `spec`, from `warm` parameters or from scratch.
    ///
    /// # Errors
    /// A specification that cannot be built.
    pub fn new(
        spec: ResidualSpec,
        models: FamilyModels,
        config: FamilyConfig,
        warm: Option<&[f32]>,
    ) -> Result<Self, ResidualError> {
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let parameters = warm.map_or_else(|| initial_parameters(&mut rng), <[f32]>::to_vec);
        let base = Residual::new(spec, Network::zero())?;
        let ticks = shared::math::ticks(config.inspiratory_time, spec.period_us) as usize;
        let shards = config.batch.div_ceil(LANES).max(1);
        let state = Checkpoint {
            iteration: 0,
            adam: Adam::new(config.adam, parameters.len()),
            best: (f64::INFINITY, parameters.clone()),
            factors: Vec::new(),
            parameters,
        };
        let tapes = (0..shards).map(|_| ClosedLoopTape::new(&models.trained_on, ticks)).collect();
        let mut training =
            Self { config, base, ticks, models, courses: Vec::new(), tapes, base_score: 0.0, state };
        training.base_score = training.validate(&vec![0.0; Network::PARAMETERS]);
        training.keep_best();
        Ok(training)
    }

    /// Geometric mean of the scores in the first breaths on held-out units, cmH2O: errors count in relation to what a unit allows.
    fn validate(&self, parameters: &[f32]) -> f64 {
        let controller = LaneController::new(&self.base, parameters);
        let (config, model) = (&self.config, &self.models.held_out);
        let units = model.architecture().members() as u32;
        let of_shard = |shard: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
            rng.set_stream(VALIDATION_STREAM + shard as u64);
            let mut courses = Courses::new(units, self.base.spec().period_us, config, &mut rng);
            let mut tape = ClosedLoopTape::new(model, self.ticks);
            let breath = |_| {
                let scenario = courses.scenario(config, self.ticks, &mut rng);
                let loss = controller.forward(model, &scenario, &mut tape);
                courses.end(&tape);
                logarithm(&loss.score)
            };
            mean(&(0..VALIDATION.1).map(breath).collect::<Vec<_>>())
        };
        let shards: Vec<f64> = (0..VALIDATION.0).into_par_iter().map(of_shard).collect();
        mean(&shards).exp()
    }
}

impl Stepwise for FamilyTraining {
    type Controller = Residual;

    fn checkpoint(&self) -> &Checkpoint {
        &self.state
    }

    fn resume(&mut self, checkpoint: Checkpoint) {
        self.state = checkpoint;
    }

    fn schedule(&self) -> (usize, usize) {
        (self.config.iterations, self.config.validate_every)
    }

    /// Starts all courses again.
    fn prepare(&mut self) {
        let Self { config, models, base, state, .. } = &*self;
        let units = models.trained_on.architecture().members() as u32;
        let courses = (0..self.tapes.len()).map(|shard| {
            let mut rng = stream(config, state.iteration, shard);
            Courses::new(units, base.spec().period_us, config, &mut rng)
        });
        self.courses = courses.collect();
    }

    /// The score is a geometric mean.
    fn step(&mut self) -> f64 {
        let Self { config, base, ticks, models, courses, tapes, state, .. } = self;
        let controller = LaneController::new(base, &state.parameters);
        let (size, iteration, model) = (state.parameters.len(), state.iteration, &models.trained_on);
        let parts: Vec<(f64, Vec<f32>)> = courses
            .par_iter_mut()
            .zip(tapes)
            .enumerate()
            .map(|(shard, (courses, tape))| {
                let mut rng = stream(config, iteration + 1, shard);
                courses.pass(config, &mut rng);
                let mut scenario = courses.scenario(config, *ticks, &mut rng);
                let loss = controller.forward(model, &scenario, tape);
                scenario.weight = courses.weights(&loss.score, config);
                let mut gradient = vec![0.0; size];
                controller.backward(&scenario, tape, &mut gradient);
                courses.end(tape);
                (logarithm(&loss.score), gradient)
            })
            .collect();
        let mut gradient = vec![0.0; size];
        for (_, part) in &parts {
            for (sum, part) in gradient.iter_mut().zip(part) {
                *sum += part / (parts.len() * LANES) as f32;
            }
        }
        let progress = state.iteration as f32 / config.iterations as f32;
        state.adam.step(&mut state.parameters, &gradient, progress);
        state.iteration += 1;
        mean(&parts.iter().map(|(score, _)| *score).collect::<Vec<_>>()).exp()
    }

    fn keep_best(&mut self) -> f64 {
        let validation = self.validate(&self.state.parameters);
        if validation < self.state.best.0 {
            self.state.best = (validation, self.state.parameters.clone());
        }
        validation
    }

    fn finish(&self) -> Result<Trained, ResidualError> {
        Trained::of(&self.base, self.base_score, &self.state.best)
    }
}

/// Random numbers of a shard in a gradient step. The courses that begin after a step are drawn from the same numbers as its noise:
/// neither depends on what is learned.
fn stream(config: &FamilyConfig, iteration: usize, shard: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(((iteration as u64 + 1) << 16) + shard as u64);
    rng
}

/// Mean logarithm of the lanes' scores.
fn logarithm(score: &Lane) -> f64 {
    f64::from(score.map(f32::ln).sum()) / LANES as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::model::Architecture;
    use crate::simulator::unit::UnitConfig;
    use shared::control::features::FeatureSpec;
    use shared::control::pid::PidGains;

    fn training(iterations: usize) -> FamilyTraining {
        let spec = ResidualSpec {
            period_us: 10_000,
            gains: PidGains { p: 1.0, i: 20.0, d: 0.0 },
            lambda: 1.0,
            authority: 100.0,
            features: FeatureSpec::for_period(10_000),
        };
        let units = UnitConfig::for_period(10_000, 4);
        let mut parameters = units.initialise();
        for (n, parameter) in parameters.iter_mut().enumerate() {
            *parameter += 0.2 * (n as f32).sin();
        }
        let model = Model::new(Architecture::Unit(units), &parameters);
        let models = FamilyModels { trained_on: model.clone(), held_out: model };
        let config = FamilyConfig { iterations, batch: 64, validate_every: 30, ..FamilyConfig::default() };
        FamilyTraining::new(spec, models, config, None).unwrap()
    }

    #[test]
    fn training_beats_its_pid_and_uses_what_it_remembers() {
        let mut training = training(120);
        while training.advance().is_some() {}
        let trained = training.finish().unwrap();
        assert!(trained.improved && trained.validation < 0.8 * trained.base, "{trained:?}");
        let of_memory = |network: &Network| {
            let first = &network.hidden_1.weights;
            first[shared::control::features::FEATURES..].iter().flatten().map(|w| w.abs()).sum::<f32>()
        };
        assert!(of_memory(trained.controller.network()) > 0.1);
    }

    #[test]
    fn random_pips_go_beyond_the_waveforms_but_not_beyond_the_settings_bounds() {
        let range = |pips: &[f32]| FamilyConfig::default().in_breaths(&Settings::default(), pips).pip_range;
        assert_eq!(range(&[20.0, 10.0, 35.0]), FamilyConfig::default().pip_range);
        assert_eq!(range(&[6.0, 50.0]), (6.0, 50.0));
    }

    #[test]
    fn a_resumed_training_ends_like_one_that_was_not_stopped() {
        let mut whole = training(60);
        while whole.advance().is_some() {}
        let mut first = training(60);
        first.advance();
        let mut second = training(60);
        second.resume(first.checkpoint().clone());
        while second.advance().is_some() {}
        assert_eq!(whole.checkpoint().parameters, second.checkpoint().parameters);
    }
}
