//! Training one controller for a family of units.
//!
//! Each lane follows a course of breaths on one unit. After a gradient step, the lane remembers the breath just run; with a small
//! probability, it starts a new course on another unit. So the controller trains on first, second and late breaths, with memories
//! that it has made itself. In every step, the margins of some loops are measured too, on `plateaus`. After every validation all
//! courses start again, so that a stopped training continues exactly.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use shared::control::network::Network;
use shared::control::residual::{Residual, ResidualError, ResidualSpec};

use super::config::FamilyConfig;
use super::courses::Courses;
use super::network::initial_parameters;
use super::oracle;
use super::plateaus;
use super::rollout::{ClosedLoopTape, LaneController};
use super::scenario::Scenario;
use super::tapes::Tapes;
use super::training::{Checkpoint, Stepwise, Trained, mean};
use crate::simulator::model::Model;
use engine::adam::Adam;
use engine::{LANES, Lane};

/// Shards and breaths of a validation.
const VALIDATION: (usize, u32) = (12, 6);
/// Norm of a shard's gradient, in medians of all shards, from which it counts no more: that of a loop close to instability would
/// outweigh all others.
const MOST_OF_MEDIAN: f32 = 3.0;
/// Part of the rate's schedule that is over when trained weights are the start: the full rate would lose what they know.
const WARM_PROGRESS: f32 = 0.5;
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
    models: FamilyModels,
    /// Part of the rate's schedule that is over at the start.
    progress: f32,
    courses: Vec<Courses>,
    tapes: Tapes<ClosedLoopTape>,
    base_score: f64,
    state: Checkpoint,
}

impl FamilyTraining {
    /// Prepares the training of the residual of `spec`, from `warm` parameters, those of a trained network, or from scratch.
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
        let state = Checkpoint {
            iteration: 0,
            adam: Adam::new(config.adam, parameters.len()),
            best: (f64::INFINITY, parameters.clone()),
            factors: Vec::new(),
            parameters,
        };
        let (courses, tapes) = (Vec::new(), Tapes::new());
        let progress = if warm.is_some() { WARM_PROGRESS } else { 0.0 };
        let mut training = Self { config, base, models, progress, courses, tapes, base_score: 0.0, state };
        training.base_score = training.validate(&vec![0.0; Network::PARAMETERS]);
        training.keep_best();
        Ok(training)
    }

    /// Score and gradient of the next breath of every shard's courses.
    fn on_courses(&mut self) -> Vec<(f64, Vec<f32>)> {
        let longest = self.longest();
        let Self { config, base, models, courses, tapes, state, .. } = self;
        let (controller, model) = (LaneController::new(base, &state.parameters), &models.trained_on);
        let of_shard = |(shard, courses): (usize, &mut Courses), tape: &mut ClosedLoopTape| {
            let mut rng = stream(config, state.iteration + 1, shard);
            courses.pass(config, &mut rng);
            let mut scenario = courses.scenario(config, &mut rng);
            tell(config, model, &mut scenario);
            let loss = controller.forward(model, &scenario, tape);
            scenario.weight = courses.weights(&loss.score, config);
            let gradient = gradient(&controller, &scenario, tape);
            courses.end(tape);
            (logarithm(&loss.score), gradient)
        };
        let make = || ClosedLoopTape::new(model, longest);
        let shards = courses.par_iter_mut().enumerate();
        shards.map(|shard| tapes.lend(make, |tape| of_shard(shard, tape))).collect()
    }

    /// Gradient of the margins that are measured in a step, shard by shard.
    fn on_plateaus(&self) -> Vec<Vec<f32>> {
        let Self { config, base, models, courses, tapes, state, .. } = self;
        let (controller, model) = (LaneController::new(base, &state.parameters), &models.trained_on);
        let (units, longest) = (model.architecture().members() as u32, self.longest());
        let of_shard = |shard: usize, tape: &mut ClosedLoopTape| {
            let mut rng = stream(config, state.iteration + 1, shard);
            let scenario = plateaus::draw(units, base.spec().period_us, config, &mut rng);
            controller.forward(model, &scenario, tape);
            gradient(&controller, &scenario, tape)
        };
        let make = || ClosedLoopTape::new(model, longest);
        let count = (config.plateau_share * courses.len() as f32).round() as usize;
        let shards = (courses.len()..courses.len() + count).into_par_iter();
        shards.map(|shard| tapes.lend(make, |tape| of_shard(shard, tape))).collect()
    }

    /// Ticks of the longest breath of a step.
    fn longest(&self) -> usize {
        let courses = self.courses.iter().map(Courses::ticks).max().unwrap_or(0);
        courses.max(plateaus::longest(self.base.spec().period_us))
    }

    /// Geometric mean of the scores in the first breaths on held-out units, cmH2O: errors count in relation to what a unit allows.
    fn validate(&self, parameters: &[f32]) -> f64 {
        let controller = LaneController::new(&self.base, parameters);
        let (config, model) = (&self.config, &self.models.held_out);
        let units = model.architecture().members() as u32;
        let of_shard = |shard: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
            rng.set_stream(VALIDATION_STREAM + shard as u64);
            let place = place(shard, VALIDATION.0);
            let mut courses = Courses::new(units, self.base.spec().period_us, place, config, &mut rng);
            let mut tape = ClosedLoopTape::new(model, courses.ticks());
            let breath = |_| {
                let mut scenario = courses.scenario(config, &mut rng);
                tell(config, model, &mut scenario);
                let loss = controller.forward(model, &scenario, &mut tape);
                courses.end(&tape);
                logarithm(&loss.score)
            };
            let breaths = if config.told.is_some() { 1 } else { VALIDATION.1 };
            mean(&(0..breaths).map(breath).collect::<Vec<_>>())
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
        let Self { config, models, base, state, courses, tapes, .. } = self;
        let units = models.trained_on.architecture().members() as u32;
        let shards = config.batch.div_ceil(LANES).max(1);
        let begin = |shard| {
            let mut rng = stream(config, state.iteration, shard);
            Courses::new(units, base.spec().period_us, place(shard, shards), config, &mut rng)
        };
        *courses = (0..shards).map(begin).collect();
        // Inspirations of another length need another tape.
        *tapes = Tapes::new();
    }

    /// The score is a geometric mean.
    fn step(&mut self) -> f64 {
        let (scores, mut gradients): (Vec<f64>, Vec<Vec<f32>>) = self.on_courses().into_iter().unzip();
        gradients.extend(self.on_plateaus());
        let Self { config, state, .. } = self;
        let done = state.iteration as f32 / config.iterations as f32;
        let progress = self.progress + (1.0 - self.progress) * done;
        state.adam.step(&mut state.parameters, &together(&gradients), progress);
        state.iteration += 1;
        mean(&scores).exp()
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

/// Gradient of a rollout that has run forward.
fn gradient(controller: &LaneController<'_>, scenario: &Scenario, tape: &mut ClosedLoopTape) -> Vec<f32> {
    let mut gradient = vec![0.0; Network::PARAMETERS];
    controller.backward(scenario, tape, &mut gradient);
    gradient
}

/// Lets the oracle of a training speak, if it has one.
fn tell(config: &FamilyConfig, model: &Model, scenario: &mut Scenario) {
    if let Some(told) = config.told {
        oracle::tell(told, model, scenario);
    }
}

/// Place of a shard among all, 0 to 1.
fn place(shard: usize, shards: usize) -> f32 {
    (shard as f32 + 0.5) / shards as f32
}

/// Random numbers of a shard in a gradient step. The courses that begin after a step are drawn from the same numbers as its noise:
/// neither depends on what is learned.
fn stream(config: &FamilyConfig, iteration: usize, shard: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(((iteration as u64 + 1) << 16) + shard as u64);
    rng
}

/// Mean gradient over the rollouts of shards, none of which outweighs the others.
fn together(shards: &[Vec<f32>]) -> Vec<f32> {
    let norms: Vec<f32> = shards.iter().map(|gradient| norm(gradient)).collect();
    let most = MOST_OF_MEDIAN * median(&norms);
    let mut mean = vec![0.0; shards.first().map_or(0, Vec::len)];
    for (gradient, norm) in shards.iter().zip(norms) {
        let share = (most / norm).min(1.0) / (shards.len() * LANES) as f32;
        for (sum, part) in mean.iter_mut().zip(gradient) {
            *sum += share * part;
        }
    }
    mean
}

fn norm(gradient: &[f32]) -> f32 {
    gradient.iter().map(|g| g * g).sum::<f32>().sqrt()
}

fn median(values: &[f32]) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// Mean logarithm of the lanes' scores.
fn logarithm(score: &Lane) -> f64 {
    f64::from(score.map(f32::ln).sum()) / LANES as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::Told;
    use crate::simulator::model::Architecture;
    use crate::simulator::unit::UnitConfig;
    use shared::control::features::FeatureSpec;
    use shared::control::pid::PidGains;

    fn training(iterations: usize) -> FamilyTraining {
        training_from(iterations, None)
    }

    fn training_from(iterations: usize, warm: Option<&[f32]>) -> FamilyTraining {
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
        FamilyTraining::new(spec, models, config, warm).unwrap()
    }

    #[test]
    fn trained_weights_are_a_start_that_few_gentle_steps_keep() {
        let mut first = training(120);
        while first.advance().is_some() {}
        let (best, trained) = first.state.best.clone();
        let mut second = training_from(30, Some(&trained));
        assert!((second.state.best.0 - best).abs() < 1e-9, "it starts where the first training ended");
        second.advance();
        let moved = |from: &[f32], to: &[f32]| {
            from.iter().zip(to).map(|(from, to)| (from - to).abs()).fold(0.0, f32::max)
        };
        // Adam moves a weight by about the rate in a step; from the middle of its schedule on, that is a fifth of the full one.
        let most = 30.0 * 0.25 * second.config.adam.rate;
        let by = moved(&trained, &second.state.parameters);
        assert!(by > 0.0 && by < most, "{by}, {most}");
        assert!(second.finish().unwrap().validation <= best);
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
    fn margins_and_what_an_oracle_tells_reach_the_weights() {
        // The output layer is zero at first, so that only the later steps reach the hidden ones.
        let after_some_steps = |change: &dyn Fn(&mut FamilyConfig)| {
            let mut training = training(4);
            // A PID so stiff that the sensitivity exceeds its bound.
            let stiff = ResidualSpec { gains: PidGains { p: 8.0, i: 20.0, d: 0.0 }, ..*training.base.spec() };
            training.base = Residual::new(stiff, Network::zero()).unwrap();
            change(&mut training.config);
            training.advance();
            training.state.parameters
        };
        let usual = after_some_steps(&|_| ());
        assert!(usual != after_some_steps(&|config| config.plateau_share = 0.0), "plateaus");
        assert!(usual != after_some_steps(&|config| config.margin_price = 0.0), "price");
        let [nothing, machine, unit, student] = [Told::Nothing, Told::Machine, Told::Unit, Told::Student]
            .map(|told| after_some_steps(&|config| config.told = Some(told)));
        assert!(nothing != machine && machine != unit && unit != student, "oracle");
    }

    #[test]
    fn a_shard_close_to_instability_counts_as_three_usual_ones() {
        let (usual, wild) = (vec![3.0, 4.0], vec![3e6, 4e6]);
        let mean = together(&[usual.clone(), wild, usual.clone()]);
        for (mean, usual) in mean.iter().zip(usual) {
            assert!((mean - 5.0 * usual / (3 * LANES) as f32).abs() < 1e-4, "{mean}");
        }
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
