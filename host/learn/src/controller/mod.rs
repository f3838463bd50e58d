//! Training the residual controller by back-propagation through learned simulators.
//!
//! One step draws a batch of inspirations (the six waveforms of the paper and random PIPs, fresh sensor noise),
//! runs them in closed loop on the simulators, and follows the gradient of the L1 error. Every few steps the
//! controller is validated on a simulator, PIPs and noise that training never sees; the best one is kept, and
//! never one that is worse there than the PID it is built on.

pub mod learned;
pub mod network;
pub mod rollout;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::PAPER_PIPS;
use shared::control::residual::{Residual, ResidualError, ResidualSpec};

use crate::simulator::hybrid::HybridTape;
use crate::simulator::model::{Model, Simulator};
use crate::simulator::state_space::StateSpaceTape;
use crate::simulator::stitched::StitchedTape;
use crate::simulator::{Dynamics, Start};
use engine::adam::{Adam, AdamConfig};
use engine::{LANES, Lane};
use network::{blind_to, chip_network, initial_parameters};
use rollout::{LaneController, Loss, Scenario, Tape};

/// How to train.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Gradient steps.
    pub iterations: usize,
    /// Inspirations per step (rounded up to whole shards).
    pub batch: usize,
    /// PIPs of the waveforms that every shard breathes, cmH2O; also those of the validation.
    pub pips: Vec<f32>,
    /// Range of the random PIPs that fill up a shard, cmH2O.
    pub pip_range: (f32, f32),
    /// Positive end-expiratory pressure, cmH2O.
    pub peep: f32,
    /// Command before the inspiration, percent.
    pub rest: f32,
    /// Inspiratory time, s.
    pub inspiratory_time: f32,
    /// Factor on errors above the target.
    pub overshoot_weight: f32,
    /// Standard deviation of how far the starting pressure strays from its mean, cmH2O.
    pub start_spread: f32,
    /// Standard deviation of the sensor's noise, cmH2O; none takes what the simulators' recordings let estimate, which
    /// needs a control period far shorter than the changes of the pressure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor_noise: Option<f32>,
    /// How much each plant counts, where there are several.
    pub weighting: Weighting,
    /// Features that the network does not get to see, by their index in [`shared::control::features`]; tells what a
    /// feature is worth.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub blind_to: Vec<usize>,
    /// Steps between validations.
    pub validate_every: usize,
    /// Optimiser.
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
            weighting: Weighting::Sum,
            blind_to: Vec::new(),
            validate_every: 25,
            adam: AdamConfig { rate: 4e-3, final_share: 0.02, weight_decay: 1e-4, clip: 1.0 },
            seed: 0,
        }
    }
}

/// How much each plant's error counts in the loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weighting {
    /// All the same: the mean score becomes small.
    #[default]
    Sum,
    /// By the softmax of the scores over this temperature, cmH2O, as the paper's authors do: the worst score becomes
    /// small.
    Softmax(f64),
}

impl Weighting {
    /// Factors with mean one, from the plants' last scores.
    fn factors(self, scores: &[f64]) -> Vec<f32> {
        let Self::Softmax(temperature) = self else { return vec![1.0; scores.len()] };
        let highest = scores.iter().copied().fold(f64::MIN, f64::max);
        let powers: Vec<f64> = scores.iter().map(|score| ((score - highest) / temperature).exp()).collect();
        let mean = powers.iter().sum::<f64>() / powers.len() as f64;
        powers.iter().map(|power| (power / mean) as f32).collect()
    }
}

/// The learned simulators of one plant.
#[derive(Clone, Copy, Debug)]
pub struct PlantModels<'a> {
    /// Those to train on.
    pub trained_on: &'a [Simulator],
    /// The one that judges.
    pub held_out: &'a Simulator,
}

/// A simulator in use.
#[derive(Debug)]
struct Member {
    model: Model,
    noise: f32,
    start: f32,
}

impl Member {
    fn new(simulator: &Simulator, config: &TrainConfig) -> Self {
        let noise = config.sensor_noise.unwrap_or(simulator.noise);
        Self { model: simulator.model(), noise, start: simulator.start_pressure }
    }
}

/// A plant's simulators in use.
#[derive(Debug)]
struct Ensemble {
    trained_on: Vec<Member>,
    held_out: Member,
}

/// A point of the training curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Gradient steps done.
    pub iteration: usize,
    /// Score of the last training batch, cmH2O.
    pub training: f64,
    /// Score on the held-out simulator, cmH2O.
    pub validation: f64,
}

/// Outcome of a training.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The best controller found: at worst the one that training started from, or the PID alone.
    pub controller: Residual,
    /// Its score on the held-out simulator, cmH2O.
    pub validation: f64,
    /// Score of the PID alone on the held-out simulator, cmH2O.
    pub base: f64,
    /// Whether the residual is better than the PID alone; if not, the controller's network is zero.
    pub improved: bool,
}

/// Memory of a shard's rollout on either architecture.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "one exists per shard")]
enum ShardTape {
    StateSpace(Tape<StateSpaceTape>),
    Hybrid(Tape<HybridTape>),
    Stitched(Tape<StitchedTape>),
}

/// A training that can be advanced step by step, watched, stopped and resumed.
#[derive(Debug)]
pub struct Training {
    config: TrainConfig,
    base: Residual,
    plants: Vec<Ensemble>,
    /// Factor on each plant's loss.
    factors: Vec<f32>,
    ticks: usize,
    parameters: Vec<f32>,
    adam: Adam,
    tapes: Vec<ShardTape>,
    iteration: usize,
    best: (f64, Vec<f32>),
    base_score: f64,
}

/// What a training needs to go on later.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Gradient steps done.
    pub iteration: usize,
    /// Network parameters.
    pub parameters: Vec<f32>,
    /// Optimiser.
    pub adam: Adam,
    /// Best validation score and its parameters.
    pub best: (f64, Vec<f32>),
    /// Factor on each plant's loss.
    pub factors: Vec<f32>,
}

/// Number of the validation's random stream; training uses those of its steps.
const VALIDATION_STREAM: u64 = u64::MAX;

impl Training {
    /// Prepares a training of the residual of `spec` on the simulators of one or several plants, from `warm` parameters
    /// or from scratch.
    ///
    /// # Errors
    /// A specification that cannot be built.
    ///
    /// # Panics
    /// Without a plant, with one that has no simulator to train on, or blind to a feature that does not exist.
    pub fn new(
        spec: ResidualSpec,
        plants: &[PlantModels<'_>],
        config: TrainConfig,
        warm: Option<&[f32]>,
    ) -> Result<Self, ResidualError> {
        assert!(!plants.is_empty(), "training needs at least one plant");
        assert!(plants.iter().all(|plant| !plant.trained_on.is_empty()), "each plant needs a simulator");
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let fresh = initial_parameters(&mut rng);
        let base = Residual::new(spec, chip_network(&vec![0.0; fresh.len()]))?;
        let mut parameters = warm.map_or(fresh, <[f32]>::to_vec);
        blind_to(&config.blind_to, &mut parameters);
        let ticks = shared::math::ticks(config.inspiratory_time, spec.period_us) as usize;
        let plants: Vec<Ensemble> = plants
            .iter()
            .map(|plant| Ensemble {
                trained_on: plant
                    .trained_on
                    .iter()
                    .map(|simulator| Member::new(simulator, &config))
                    .collect(),
                held_out: Member::new(plant.held_out, &config),
            })
            .collect();
        // Each plant has as many shards as any other.
        let shards = config.batch.div_ceil(LANES).max(1).next_multiple_of(plants.len());
        let lanes = LaneController::new(&base, &parameters);
        let tapes = (0..shards)
            .map(|shard| tape(&lanes, &plants[shard % plants.len()].trained_on[0].model, ticks))
            .collect();
        let adam = Adam::new(config.adam, parameters.len());
        let mut training = Self {
            factors: vec![1.0; plants.len()],
            best: (f64::INFINITY, parameters.clone()),
            base_score: 0.0,
            iteration: 0,
            config,
            base,
            plants,
            ticks,
            parameters,
            adam,
            tapes,
        };
        training.base_score = mean(&training.validate(&vec![0.0; training.parameters.len()]));
        training.keep_best();
        Ok(training)
    }

    /// Goes on from a checkpoint.
    pub fn resume(&mut self, checkpoint: Checkpoint) {
        let Checkpoint { iteration, parameters, adam, best, factors } = checkpoint;
        (self.iteration, self.parameters, self.adam, self.best) = (iteration, parameters, adam, best);
        self.factors = factors;
    }

    /// What to keep so that training can go on later.
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint {
            iteration: self.iteration,
            parameters: self.parameters.clone(),
            adam: self.adam.clone(),
            best: self.best.clone(),
            factors: self.factors.clone(),
        }
    }

    /// Gradient steps done.
    pub fn iteration(&self) -> usize {
        self.iteration
    }

    /// Steps until the next validation; none when training is done.
    pub fn advance(&mut self) -> Option<CurvePoint> {
        if self.iteration >= self.config.iterations {
            return None;
        }
        let mut training = 0.0;
        let until = (self.iteration + self.config.validate_every.max(1)).min(self.config.iterations);
        while self.iteration < until {
            training = self.step();
        }
        let validation = self.keep_best();
        Some(CurvePoint { iteration: self.iteration, training, validation })
    }

    /// Validates the present parameters and keeps them if they are the best so far; the mean score over the plants.
    fn keep_best(&mut self) -> f64 {
        let scores = self.validate(&self.parameters);
        self.factors = self.config.weighting.factors(&scores);
        let validation = mean(&scores);
        if validation < self.best.0 {
            self.best = (validation, self.parameters.clone());
        }
        validation
    }

    /// One gradient step; the batch's mean score.
    pub fn step(&mut self) -> f64 {
        let size = self.parameters.len();
        let parts = self.on_shards(|controller, model, scenario, tape| {
            let mut gradient = vec![0.0; size];
            let score = gradient_of(controller, model, scenario, tape, &mut gradient);
            (score, gradient)
        });
        let mut gradient = vec![0.0; size];
        let mut score = 0.0;
        for (part_score, part) in &parts {
            score += part_score / parts.len() as f64;
            for (sum, part) in gradient.iter_mut().zip(part) {
                *sum += part / (parts.len() * LANES) as f32;
            }
        }
        blind_to(&self.config.blind_to, &mut gradient);
        let progress = self.iteration as f32 / self.config.iterations as f32;
        self.adam.step(&mut self.parameters, &gradient, progress);
        self.iteration += 1;
        score
    }

    /// The next step's batch in closed loop, without learning from it; its mean score.
    pub fn rehearse(&mut self) -> f64 {
        let scores = self.on_shards(score_of);
        scores.iter().sum::<f64>() / scores.len() as f64
    }

    /// Draws the next step's batch and gives each shard to `work`, in parallel; results in the shards' order.
    fn on_shards<T: Send>(
        &mut self,
        work: impl Fn(&LaneController<'_>, &Model, &Scenario, &mut ShardTape) -> T + Sync,
    ) -> Vec<T> {
        let controller = LaneController::new(&self.base, &self.parameters);
        let (config, plants, factors, ticks, iteration) =
            (&self.config, &self.plants, &self.factors, self.ticks, self.iteration);
        let shards_each = self.tapes.len() / plants.len();
        self.tapes
            .par_iter_mut()
            .enumerate()
            .map(|(shard, tape)| {
                let (plant, turn) = (shard % plants.len(), shard / plants.len());
                let members = &plants[plant].trained_on;
                // With fewer shards than members these take turns.
                let turn = if shards_each < members.len() { turn + iteration } else { turn };
                let member = &members[turn % members.len()];
                let stream = (iteration as u64).wrapping_mul(1 << 16) + shard as u64;
                let mut scenario = draw(config, ticks, member, stream);
                scenario.weight = Lane::splat(factors[plant]);
                work(&controller, &member.model, &scenario, tape)
            })
            .collect()
    }

    /// Score of every plant on its held-out simulator, mean over the waveforms, cmH2O.
    fn validate(&self, parameters: &[f32]) -> Vec<f64> {
        let controller = LaneController::new(&self.base, parameters);
        let pips = &self.config.pips;
        let of_plant = |plant: &Ensemble| {
            let mut scenario = draw(&self.config, self.ticks, &plant.held_out, VALIDATION_STREAM);
            scenario.pip = Lane::from_fn(|l| pips[l % pips.len()]);
            scenario.start.plateau = scenario.pip;
            let mut tape = tape(&controller, &plant.held_out.model, self.ticks);
            let score = loss_of(&controller, &plant.held_out.model, &scenario, &mut tape).score;
            let of_pip = |pip: usize| {
                let own: Vec<f64> =
                    (0..LANES).filter(|l| l % pips.len() == pip).map(|l| f64::from(score[l])).collect();
                mean(&own)
            };
            mean(&(0..pips.len()).map(of_pip).collect::<Vec<_>>())
        };
        self.plants.par_iter().map(of_plant).collect()
    }

    /// Ends the training with the best controller.
    ///
    /// # Errors
    /// Weights that outgrew their bound.
    pub fn finish(&self) -> Result<Trained, ResidualError> {
        let (validation, parameters) = &self.best;
        let improved = *validation < self.base_score;
        let controller = if improved {
            Residual::new(*self.base.spec(), chip_network(parameters))?
        } else {
            self.base.clone()
        };
        let validation = validation.min(self.base_score);
        Ok(Trained { controller, validation, base: self.base_score, improved })
    }

    /// Parameters as they are now.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }
}

fn tape(controller: &LaneController<'_>, model: &Model, ticks: usize) -> ShardTape {
    match model {
        Model::StateSpace(model) => ShardTape::StateSpace(controller.tape(model, ticks)),
        Model::Hybrid(model) => ShardTape::Hybrid(controller.tape(model, ticks)),
        Model::Stitched(model) => ShardTape::Stitched(controller.tape(model, ticks)),
    }
}

/// A shard's forward and backward pass; its mean score.
fn gradient_of(
    controller: &LaneController<'_>,
    model: &Model,
    scenario: &Scenario,
    tape: &mut ShardTape,
    gradient: &mut [f32],
) -> f64 {
    match (model, tape) {
        (Model::StateSpace(model), ShardTape::StateSpace(tape)) => {
            both_ways(controller, model, scenario, tape, gradient)
        }
        (Model::Hybrid(model), ShardTape::Hybrid(tape)) => {
            both_ways(controller, model, scenario, tape, gradient)
        }
        (Model::Stitched(model), ShardTape::Stitched(tape)) => {
            both_ways(controller, model, scenario, tape, gradient)
        }
        _ => unreachable!("each shard's tape was made for its model"),
    }
}

/// A shard's forward pass; its mean score.
fn score_of(
    controller: &LaneController<'_>,
    model: &Model,
    scenario: &Scenario,
    tape: &mut ShardTape,
) -> f64 {
    f64::from(loss_of(controller, model, scenario, tape).score.sum()) / LANES as f64
}

/// A shard's forward pass.
fn loss_of(
    controller: &LaneController<'_>,
    model: &Model,
    scenario: &Scenario,
    tape: &mut ShardTape,
) -> Loss {
    match (model, tape) {
        (Model::StateSpace(model), ShardTape::StateSpace(tape)) => controller.forward(model, scenario, tape),
        (Model::Hybrid(model), ShardTape::Hybrid(tape)) => controller.forward(model, scenario, tape),
        (Model::Stitched(model), ShardTape::Stitched(tape)) => controller.forward(model, scenario, tape),
        _ => unreachable!("each shard's tape was made for its model"),
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn both_ways<M: Dynamics>(
    controller: &LaneController<'_>,
    model: &M,
    scenario: &Scenario,
    tape: &mut Tape<M::Tape>,
    gradient: &mut [f32],
) -> f64 {
    let loss = controller.forward(model, scenario, tape);
    controller.backward(model, scenario, tape, gradient);
    f64::from(loss.score.sum()) / LANES as f64
}

/// Draws a shard's inspirations.
fn draw(config: &TrainConfig, ticks: usize, simulator: &Member, stream: u64) -> Scenario {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(stream);
    let pip = Lane::from_fn(|l| match config.pips.get(l) {
        Some(pip) => *pip,
        None => rng.random_range(config.pip_range.0..config.pip_range.1),
    });
    let mut normal = |sd: f32| -> f32 { sd * rng.sample::<f32, _>(StandardNormal) };
    Scenario {
        ticks,
        pip,
        peep: config.peep,
        start: Start {
            pressure: Lane::from_fn(|_| simulator.start + normal(config.start_spread)),
            plateau: pip,
            ..Start::default()
        },
        rest: config.rest,
        noise: (0..ticks).map(|_| Lane::from_fn(|_| normal(simulator.noise))).collect(),
        weight: Lane::splat(1.0),
        overshoot_weight: config.overshoot_weight,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::first_order;
    use shared::control::features::{FEATURES, FeatureSpec};
    use shared::control::network::HIDDEN_1;
    use shared::control::pid::PidGains;

    #[test]
    fn what_training_is_blind_to_stays_without_weight_and_all_else_is_learned() {
        let spec = ResidualSpec {
            period_us: 1000,
            gains: PidGains { p: 1.0, i: 20.0, d: 0.0 },
            lambda: 1.0,
            authority: 100.0,
            features: FeatureSpec::default(),
        };
        let config = TrainConfig { iterations: 3, batch: 16, blind_to: vec![3, 9], ..TrainConfig::default() };
        let simulator = first_order(1.0);
        let plant = PlantModels { trained_on: std::slice::from_ref(&simulator), held_out: &simulator };
        let mut training = Training::new(spec, &[plant], config, None).unwrap();
        let before = training.parameters().to_vec();
        for _ in 0..3 {
            training.step();
        }
        let column = |parameters: &[f32], feature: usize| -> Vec<f32> {
            (0..HIDDEN_1).map(|row| parameters[row * FEATURES + feature]).collect()
        };
        for feature in 0..FEATURES {
            let learned = column(training.parameters(), feature);
            if [3, 9].contains(&feature) {
                assert!(learned.iter().all(|weight| *weight == 0.0), "feature {feature}");
            } else {
                assert_ne!(learned, column(&before, feature), "feature {feature}");
            }
        }
    }

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
