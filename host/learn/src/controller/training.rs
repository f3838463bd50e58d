//! Training a controller of any architecture: gradient steps, validation, checkpoints.
//!
//! One step draws a batch of inspirations (the paper's six waveforms and random PIPs, prescriptions, new sensor noise), runs them in
//! closed loop on the simulators, and follows the gradient of the L1 error. At intervals the controller is validated on
//! a simulator, PIPs and noise not used in training; the best one is kept. A controller that is worse there than its
//! PID is never kept.

use plant::prescriptions::Prescriptions;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::control::residual::{Residual, ResidualError, ResidualSpec};
use shared::settings::Settings;

use super::architecture::Trainable;
use super::config::TrainConfig;
use super::rollout::{ClosedLoopTape, LaneController};
use super::scenario::{Scenario, Waveforms};
use super::tapes::Tapes;
use crate::simulator::model::{Model, Simulator};
use engine::adam::Adam;
use engine::{LANES, Lane};

/// The learned simulators of one plant.
#[derive(Clone, Copy, Debug)]
pub struct PlantModels<'a> {
    /// The simulators to train on.
    pub trained_on: &'a [Simulator],
    /// The held-out simulator, used for validation.
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

    /// A shard's inspirations with the usual waveforms or, if the training has any, with drawn prescriptions.
    fn draw(&self, config: &TrainConfig, usual: bool, period_s: f32, rng: &mut ChaCha8Rng) -> Scenario {
        let waveforms = match &config.prescriptions {
            Some(prescriptions) if !usual => Waveforms::drawn(prescriptions, period_s, rng),
            _ => Waveforms::usual(config, self.start_in(config), period_s, rng),
        };
        Scenario::draw(config, &waveforms, self.noise, rng)
    }

    /// Pressure before an inspiration with the usual waveform, cmH2O: that of the recordings, if they had the same PEEP.
    fn start_in(&self, config: &TrainConfig) -> f32 {
        if config.prescriptions.is_some() { config.peep } else { self.start }
    }
}

/// A plant's simulators in use.
#[derive(Debug)]
struct Ensemble {
    trained_on: Vec<Member>,
    held_out: Member,
}

impl Ensemble {
    fn new(plant: &PlantModels<'_>, config: &TrainConfig) -> Self {
        Self {
            trained_on: plant.trained_on.iter().map(|simulator| Member::new(simulator, config)).collect(),
            held_out: Member::new(plant.held_out, config),
        }
    }
}

/// A point of the training curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Number of gradient steps done.
    pub iteration: usize,
    /// Score of the last training batch, cmH2O.
    pub training: f64,
    /// Score on the held-out simulator, cmH2O.
    pub validation: f64,
}

/// Result of a training.
#[derive(Clone, Debug)]
pub struct Trained<C = Residual> {
    /// The best controller found; at worst, the initial one or the PID alone.
    pub controller: C,
    /// Its score on the held-out simulator, cmH2O.
    pub validation: f64,
    /// Score of the PID alone on the held-out simulator, cmH2O.
    pub base: f64,
    /// Whether the residual is better than the PID alone; if not, the controller's network is zero.
    pub improved: bool,
}

impl<C: Trainable> Trained<C> {
    /// The result of a training with this best score and these parameters; the PID of `base` alone if that scores better.
    ///
    /// # Errors
    /// Weights that exceed their bound.
    pub(super) fn of(
        base: &C,
        base_score: f64,
        (validation, parameters): &(f64, Vec<f32>),
    ) -> Result<Self, ResidualError> {
        let improved = *validation < base_score;
        let controller = if improved { C::build(base.specification(), parameters)? } else { base.clone() };
        Ok(Self { controller, validation: validation.min(base_score), base: base_score, improved })
    }
}

/// A training that can be advanced step by step, observed, stopped and resumed.
#[derive(Debug)]
pub struct Training<C: Trainable = Residual> {
    config: TrainConfig,
    base: C,
    plants: Vec<Ensemble>,
    ticks: usize,
    shards: usize,
    tapes: Tapes<ClosedLoopTape<C>>,
    base_score: f64,
    /// Everything that changes from step to step.
    state: Checkpoint,
}

/// The state needed to resume a training.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Number of gradient steps done.
    pub iteration: usize,
    /// Network parameters.
    pub parameters: Vec<f32>,
    /// State of the optimiser.
    pub adam: Adam,
    /// Best validation score and its parameters.
    pub best: (f64, Vec<f32>),
    /// Factor on each plant's loss.
    pub factors: Vec<f32>,
}

/// A training that can be advanced, stopped and resumed.
pub trait Stepwise {
    /// The controller in training.
    type Controller;

    /// The state to keep for resuming the training later.
    fn checkpoint(&self) -> &Checkpoint;

    /// Continues from a checkpoint.
    fn resume(&mut self, checkpoint: Checkpoint);

    /// Number of gradient steps of the whole training, and between validations.
    fn schedule(&self) -> (usize, usize);

    /// Prepares the steps up to the next validation.
    fn prepare(&mut self) {}

    /// Makes one gradient step; returns the batch's score.
    fn step(&mut self) -> f64;

    /// Validates the present parameters and keeps the best so far; returns their score.
    fn keep_best(&mut self) -> f64;

    /// Ends the training with the best controller.
    ///
    /// # Errors
    /// Weights that exceed their bound.
    fn finish(&self) -> Result<Trained<Self::Controller>, ResidualError>;

    /// Number of gradient steps done.
    fn iteration(&self) -> usize {
        self.checkpoint().iteration
    }

    /// Trains until the next validation; `None` when training is done.
    fn advance(&mut self) -> Option<CurvePoint> {
        let (iterations, validate_every) = self.schedule();
        if self.iteration() >= iterations {
            return None;
        }
        self.prepare();
        let mut training = 0.0;
        let until = (self.iteration() + validate_every.max(1)).min(iterations);
        while self.iteration() < until {
            training = self.step();
        }
        let validation = self.keep_best();
        Some(CurvePoint { iteration: self.iteration(), training, validation })
    }
}

/// Number of the random stream for validation; training uses the numbers of its steps.
const VALIDATION_STREAM: u64 = u64::MAX;
/// Shards of drawn prescriptions in a validation.
const DRAWN_SHARDS: usize = 6;

fn stream(config: &TrainConfig, number: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(number);
    rng
}

impl Training {
    /// Prepares the training of our residual of `spec`; see [`Self::of`].
    ///
    /// # Errors
    /// A specification that cannot be built.
    pub fn new(
        spec: ResidualSpec,
        plants: &[PlantModels<'_>],
        config: TrainConfig,
        warm: Option<&[f32]>,
    ) -> Result<Self, ResidualError> {
        Self::of(spec, plants, config, warm)
    }
}

impl<C: Trainable> Training<C> {
    /// Prepares the training of the controller of `spec` on the simulators of one or several plants, from `warm`
    /// parameters or from scratch.
    ///
    /// # Errors
    /// A specification that cannot be built.
    ///
    /// # Panics
    /// Without a plant, with a plant without simulators to train on, or with a hidden feature that does not exist.
    pub fn of(
        spec: C::Spec,
        plants: &[PlantModels<'_>],
        config: TrainConfig,
        warm: Option<&[f32]>,
    ) -> Result<Self, ResidualError> {
        assert!(!plants.is_empty(), "training needs at least one plant");
        assert!(plants.iter().all(|plant| !plant.trained_on.is_empty()), "each plant needs a simulator");
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let fresh = C::initial_parameters(&mut rng);
        let base = C::build(spec, &vec![0.0; C::size()])?;
        let mut parameters = warm.map_or(fresh, <[f32]>::to_vec);
        C::blind_to(&config.blind_to, &mut parameters);
        let longest = config.prescriptions.as_ref().map_or(0.0, Prescriptions::longest_inspiration);
        let longest = config.inspiratory_time.max(longest);
        let ticks = shared::math::ticks(longest, base.fixed_parts().spec().period_us) as usize;
        let plants: Vec<Ensemble> = plants.iter().map(|plant| Ensemble::new(plant, &config)).collect();
        // All plants have the same number of shards.
        let shards = config.batch.div_ceil(LANES).max(1).next_multiple_of(plants.len());
        let state = Checkpoint {
            iteration: 0,
            adam: Adam::new(config.adam, parameters.len()),
            best: (f64::INFINITY, parameters.clone()),
            factors: vec![1.0; plants.len()],
            parameters,
        };
        let tapes = Tapes::new();
        let mut training = Self { config, base, plants, ticks, shards, tapes, base_score: 0.0, state };
        training.base_score = mean(&training.validate(&vec![0.0; C::size()]));
        training.keep_best();
        Ok(training)
    }

    /// Runs the next step's batch in closed loop without learning from it; returns its mean score.
    pub fn rehearse(&mut self) -> f64 {
        let scores = self.on_shards(|controller, model, scenario, tape| {
            controller.forward(model, scenario, tape).mean_score()
        });
        scores.iter().sum::<f64>() / scores.len() as f64
    }

    /// Draws the next step's batch and passes each shard to `work`, in parallel; results keep the shards' order.
    fn on_shards<T: Send>(
        &self,
        work: impl Fn(&LaneController<'_, C>, &Model, &Scenario, &mut ClosedLoopTape<C>) -> T + Sync,
    ) -> Vec<T> {
        let controller = LaneController::new(&self.base, &self.state.parameters);
        let (config, plants, factors, ticks, iteration) =
            (&self.config, &self.plants, &self.state.factors, self.ticks, self.state.iteration);
        let (shards_each, period_s) = (self.shards / plants.len(), self.period_s());
        (0..self.shards)
            .into_par_iter()
            .map(|shard| {
                let (plant, turn) = (shard % plants.len(), shard / plants.len());
                let members = &plants[plant].trained_on;
                // If there are fewer shards than members, the members take turns.
                let turn = if shards_each < members.len() { turn + iteration } else { turn };
                let member = &members[turn % members.len()];
                let mut rng = stream(config, (iteration as u64).wrapping_mul(1 << 16) + shard as u64);
                let usual = (shard / plants.len()).is_multiple_of(2);
                let mut scenario = member.draw(config, usual, period_s, &mut rng);
                scenario.weight = Lane::splat(factors[plant]);
                let make = || ClosedLoopTape::new(&member.model, ticks);
                self.tapes.lend(make, |tape| work(&controller, &member.model, &scenario, tape))
            })
            .collect()
    }

    /// Score of every plant on its held-out simulator, mean over the waveforms, cmH2O.
    fn validate(&self, parameters: &[f32]) -> Vec<f64> {
        let controller = LaneController::new(&self.base, parameters);
        let (pips, period_s) = (&self.config.pips, self.period_s());
        let of_plant = |plant: &Ensemble| {
            let (mut rng, model) = (stream(&self.config, VALIDATION_STREAM), &plant.held_out.model);
            let mut tape = ClosedLoopTape::new(model, self.ticks);
            let usual =
                Waveforms::usual(&self.config, plant.held_out.start_in(&self.config), period_s, &mut rng);
            let of_lane = |l: usize| Settings { pip: pips[l % pips.len()], ..usual.settings[l] };
            let usual = Waveforms { settings: std::array::from_fn(of_lane), ..usual };
            let mut scenario = Scenario::draw(&self.config, &usual, plant.held_out.noise, &mut rng);
            let score = controller.forward(model, &scenario, &mut tape).score;
            let of_pip = |pip: usize| {
                let own: Vec<f64> =
                    (0..LANES).filter(|l| l % pips.len() == pip).map(|l| f64::from(score[l])).collect();
                mean(&own)
            };
            let usual = mean(&(0..pips.len()).map(of_pip).collect::<Vec<_>>());
            if self.config.prescriptions.is_none() {
                return usual;
            }
            let mut drawn = || {
                scenario = plant.held_out.draw(&self.config, false, period_s, &mut rng);
                controller.forward(model, &scenario, &mut tape).mean_score()
            };
            mean(&[usual, mean(&[(); DRAWN_SHARDS].map(|()| drawn()))])
        };
        self.plants.par_iter().map(of_plant).collect()
    }

    /// Control period, s.
    fn period_s(&self) -> f32 {
        shared::breath::period_s(self.base.fixed_parts().spec().period_us)
    }

    /// The present parameters.
    pub fn parameters(&self) -> &[f32] {
        &self.state.parameters
    }
}

impl<C: Trainable> Stepwise for Training<C> {
    type Controller = C;

    fn checkpoint(&self) -> &Checkpoint {
        &self.state
    }

    fn resume(&mut self, checkpoint: Checkpoint) {
        self.state = checkpoint;
    }

    fn schedule(&self) -> (usize, usize) {
        (self.config.iterations, self.config.validate_every)
    }

    fn step(&mut self) -> f64 {
        let size = self.state.parameters.len();
        let parts = self.on_shards(|controller, model, scenario, tape| {
            let mut gradient = vec![0.0; size];
            let loss = controller.forward(model, scenario, tape);
            controller.backward(scenario, tape, &mut gradient);
            (loss.mean_score(), gradient)
        });
        let mut gradient = vec![0.0; size];
        let mut score = 0.0;
        for (part_score, part) in &parts {
            score += part_score / parts.len() as f64;
            for (sum, part) in gradient.iter_mut().zip(part) {
                *sum += part / (parts.len() * LANES) as f32;
            }
        }
        C::blind_to(&self.config.blind_to, &mut gradient);
        let progress = self.state.iteration as f32 / self.config.iterations as f32;
        self.state.adam.step(&mut self.state.parameters, &gradient, progress);
        self.state.iteration += 1;
        score
    }

    fn keep_best(&mut self) -> f64 {
        let scores = self.validate(&self.state.parameters);
        self.state.factors = self.config.weighting.factors(&scores);
        let validation = mean(&scores);
        if validation < self.state.best.0 {
            self.state.best = (validation, self.state.parameters.clone());
        }
        validation
    }

    fn finish(&self) -> Result<Trained<C>, ResidualError> {
        Trained::of(&self.base, self.base_score, &self.state.best)
    }
}

/// Mean of the values.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::first_order;
    use shared::control::features::{FEATURES, FeatureSpec};
    use shared::control::network::{HIDDEN_1, INPUTS};
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
            (0..HIDDEN_1).map(|row| parameters[row * INPUTS + feature]).collect()
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
}
