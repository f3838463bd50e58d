//! Commissioning: from one unit's own recording and a controller for its family to a controller for this unit.
//!
//! The unit breathes under the known-good PID and explores. A physical simulator is fitted to the recording and checked on breaths
//! left out of the fit. The controller's residual is then trained further, from its own weights and in small steps, on units drawn
//! narrowly around the fitted one: the recording does not tell everything, and a controller that exploits what it does not tell
//! would fail on the unit. Half of these units have other lungs, which the controller would otherwise forget. Further drawn units
//! validate. The best of PID, starting and fine-tuned controller wins there.
//!
//! The number of gradient steps is fixed, not the time: the same seed must give the same controller on any machine.
//!
//! With a folder, the training's checkpoints are saved there, and a stopped training continues.

use std::ops::Range;
use std::slice;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::{Residual, ResidualError};
use shared::device::KNOWN_GOOD;
use shared::settings::Settings;
use thiserror::Error;

use super::family::FamilyRun;
use super::{PipelineError, TrainedOnce, of_round, train};
use crate::controller::learned::Learned;
use crate::controller::{CurvePoint, FamilyConfig, FamilyModels, FamilyTraining, Stepwise};
use crate::simulator::episode::{Episode, episodes};
use crate::simulator::fit::{FIT, Fit, FitConfig};
use crate::simulator::model::{Architecture, Model, Simulator};
use crate::simulator::open_loop::open_loop;
use crate::simulator::unit::spread::{self, Around};
use crate::simulator::unit::{PER_UNIT, UnitConfig, UnitNumbers};
use data::recording::{INSPIRATION, Recording};
use data::workspace::Workspace;
use engine::adam::AdamConfig;
use plant::prescriptions::Prescriptions;
use progress::{Progress, Task};
use ventilator::collect::CollectConfig;
use ventilator::seeds;

/// Learning rate, as a share of that of the family's training. With a tenth, scores on the true benches of three units fell by up to
/// one percentage point less in the same number of steps.
const RATE_SHARE: f32 = 0.3;
/// Number of gradient steps: about 45 s of processor time, shared by all cores. Nearly all of the gain comes in the first half.
const ITERATIONS: usize = 1000;
/// Fewest complete breaths to commission from.
pub const BREATHS_NEEDED: usize = 8;
/// Largest open-loop distance to the measured pressure on breaths left out of the fit, cmH2O. On 32 units like those of the adult
/// family it was 0.09 to 0.36, sensor noise included; commissioning lowers the error by less than this limit.
pub const OPEN_LOOP_LIMIT: f64 = 0.6;
/// Configuration of a commissioning.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CommissionRun {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Gains of the PID that records.
    pub collector: PidGains,
    /// The recording.
    pub collect: CollectConfig,
    /// Number of parts of the recording; each is left out of one fit, which is checked on it.
    pub parts: usize,
    /// Each fit.
    pub fit: FitConfig,
    /// Number of units drawn around the fitted one, to train and to validate on.
    pub drawn: (usize, usize),
    /// How far they deviate from it. Without other lungs the controller forgets them. Drawing them uniformly,
    /// up to a factor of six away, raised the error on the unit's own lung by 0.3 to 2 % on five of six units.
    pub around: Around,
    /// Range of the sensor noise in training, as shares of the recording's.
    pub noise: (f32, f32),
    /// Training; its range of noise follows from the recording.
    pub train: FamilyConfig,
}

impl Default for CommissionRun {
    fn default() -> Self {
        let train = FamilyConfig::default();
        let adam = AdamConfig { rate: RATE_SHARE * train.adam.rate, ..train.adam };
        Self {
            seed: 1,
            collector: KNOWN_GOOD,
            // An abort means that the exploration is too strong for this lung: nothing is tried twice.
            collect: CollectConfig { breaths: 20, aborts: 0, ..CollectConfig::default() },
            parts: 4,
            fit: FamilyRun::default().fit,
            drawn: (512, 128),
            around: Around { machine: 0.05, lung: 0.1, other_lungs: 0.7 },
            noise: (0.8, 1.2),
            train: FamilyConfig { iterations: ITERATIONS, batch: 128, validate_every: 50, adam, ..train },
        }
    }
}

/// What the recording of a unit tells.
#[derive(Clone, Debug)]
pub struct Checked {
    /// Simulator of the unit, fitted to all complete breaths.
    pub simulator: Simulator,
    /// The figures.
    pub figures: Figures,
}

/// Figures of a recording and of the simulator fitted to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Number of complete breaths.
    pub breaths: usize,
    /// Open-loop distance to the measured pressure on breaths left out of the fit, noise included, cmH2O.
    pub open_loop: f64,
    /// Standard deviation of the sensor noise, cmH2O.
    pub noise: f32,
    /// Numbers of the unit.
    pub unit: UnitNumbers,
}

/// Why a unit must not be commissioned from its recording.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Problem {
    /// The ventilator's safe state ended breaths.
    #[error(
        "the ventilator's safe state ended {0} breath(s): check the lung for a blockage and the sensor, or lower the highest of --pips; then record again with another --out"
    )]
    Aborted(usize),
    /// The simulator does not predict the unit.
    #[error(
        "the open-loop distance on breaths left out of the fit is {0:.2} cmH2O, more than {OPEN_LOOP_LIMIT}: the simulator does not describe this unit, and a controller trained on it may be worse than the starting one; check for a moving circuit, a breathing patient, a loose sensor tube or a valve that sticks, then record again with another --out"
    )]
    OpenLoop(f64),
}

impl Figures {
    /// Why the unit must not be commissioned from these figures; none if it may be.
    pub fn problem(&self) -> Option<Problem> {
        // A NaN is a problem.
        if self.open_loop <= OPEN_LOOP_LIMIT { None } else { Some(Problem::OpenLoop(self.open_loop)) }
    }
}

/// Which controller won on the validation units.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Winner {
    /// The fine-tuned controller.
    FineTuned,
    /// The starting controller.
    Start,
    /// The PID alone.
    Pid,
}

/// A commissioned controller.
#[derive(Clone, Debug)]
pub struct Commissioned {
    /// The controller that won.
    pub learned: Learned,
    /// Which one it is.
    pub winner: Winner,
    /// Score of the starting controller on the validation units, cmH2O; those of winner and PID are in the controller's origin.
    pub start: f64,
    /// Training curve.
    pub curve: Vec<CurvePoint>,
    /// Whether the training was completed.
    pub complete: bool,
}

impl CommissionRun {
    /// The default in breaths with these settings and PIPs, cmH2O.
    pub fn of(settings: &Settings, pips: &[f32]) -> Self {
        let mut run = Self::default();
        run.train.usual = Prescriptions::listed("usual", pips, *settings);
        (run.collect.settings, run.collect.pip_range) = (*settings, run.train.usual.pip_range());
        run.collect.pips = pips.to_vec();
        run
    }

    /// The PID that records, at a control period in microseconds.
    ///
    /// # Errors
    /// Gains that are not valid.
    pub fn pid(&self, period_us: u32) -> Result<Controller, PipelineError> {
        Ok(Controller::Pid(Pid::new(self.collector, period_us).map_err(ResidualError::from)?))
    }

    /// The configuration of the recording of a unit, by its number among the units. Each has PIPs and perturbations of its own.
    pub fn collection(&self, unit: u64) -> CollectConfig {
        CollectConfig { seed: seeds::collection(self.seed, unit), ..self.collect.clone() }
    }

    /// Fits a simulator to a recording and checks it on breaths left out of the fit: each part of the recording is left out of one fit.
    ///
    /// # Errors
    /// A breath that the safe state ended, too few complete breaths, or a stopped fit.
    pub fn check(&self, recording: &Recording, progress: &Progress<'_>) -> Result<Checked, PipelineError> {
        let (_, mut units) = self.check_units(slice::from_ref(recording), self.parts, progress)?;
        units.pop().ok_or(PipelineError::NoSimulator)
    }

    /// Fits one simulator to the recordings of several units, with parameters of each, and checks it on one part that is left out.
    /// Returns it with what each recording tells, in their order.
    ///
    /// # Errors
    /// No recording, a breath that the safe state ended, too few complete breaths, or a stopped fit.
    pub fn check_jointly(
        &self,
        recordings: &[Recording],
        progress: &Progress<'_>,
    ) -> Result<(Simulator, Vec<Checked>), PipelineError> {
        self.check_units(recordings, 1, progress)
    }

    /// Fits one simulator to all breaths of some units, and a further one for each of so many parts left out.
    fn check_units(
        &self,
        recordings: &[Recording],
        parts: usize,
        progress: &Progress<'_>,
    ) -> Result<(Simulator, Vec<Checked>), PipelineError> {
        let Some(first) = recordings.first() else { return Err(PipelineError::NoSimulator) };
        let shape = self.shape(first.provenance.period_us, recordings.len());
        let breaths = self.breaths_of_units(recordings)?;
        let plants: Vec<&str> =
            recordings.iter().map(|recording| recording.provenance.plant.as_str()).collect();
        let (name, task) = (plants.join(", "), progress.task(FIT, self.fit.epochs * (parts + 1)));
        let fits: Option<Vec<Simulator>> = (0..=parts)
            .into_par_iter()
            .map(|part| {
                // No breath is left out of the last fit.
                let fitted = breaths.iter().enumerate();
                let fitted = fitted.filter(|(number, _)| part == parts || number % self.parts != part);
                self.fitted(shape, &fitted.map(|(_, breath)| breath).collect::<Vec<_>>(), &name, &task)
            })
            .collect();
        let mut checked = fits.ok_or(PipelineError::Stopped)?;
        let whole = checked.pop().ok_or(PipelineError::Stopped)?;
        let unit = |(unit, plant): (u32, &&str)| {
            let own = breaths.iter().enumerate().filter(move |(_, breath)| breath.ventilator == Some(unit));
            let simulator = Simulator {
                architecture: Architecture::Unit(UnitConfig { units: 1, ..shape }),
                parameters: whole.parameters[unit as usize * PER_UNIT..][..PER_UNIT].to_vec(),
                plant: (*plant).to_owned(),
                ..whole.clone()
            };
            self.told(&own.collect::<Vec<_>>(), simulator, &checked)
        };
        let units = (0..).zip(&plants).map(unit).collect();
        Ok((whole, units))
    }

    /// What the numbered breaths of a unit tell, by its simulator and by those from whose fit a part was left out.
    fn told(&self, breaths: &[(usize, &Episode)], simulator: Simulator, checked: &[Simulator]) -> Checked {
        let distance = |(part, simulator): (usize, &Simulator)| {
            let left_out = breaths.iter().filter(|(number, _)| number % self.parts == part);
            open_loop(simulator, &left_out.map(|(_, breath)| *breath).collect::<Vec<_>>()).measured
        };
        let figures = Figures {
            breaths: breaths.len(),
            open_loop: checked.iter().enumerate().map(distance).sum::<f64>() / checked.len() as f64,
            noise: simulator.noise,
            unit: UnitNumbers::of(&simulator.parameters),
        };
        Checked { simulator, figures }
    }

    /// The complete breaths of all units, which name their unit.
    fn breaths_of_units(&self, recordings: &[Recording]) -> Result<Vec<Episode>, PipelineError> {
        let mut breaths = Vec::new();
        for (unit, recording) in (0..).zip(recordings) {
            let own = self.complete_breaths(recording)?.into_iter();
            breaths.extend(own.map(|breath| Episode { ventilator: Some(unit), group: Some(unit), ..breath }));
        }
        Ok(breaths)
    }

    /// Checks that a recording can be fitted.
    ///
    /// # Errors
    /// A breath that the safe state ended, or too few complete breaths.
    pub fn usable(&self, recording: &Recording) -> Result<(), PipelineError> {
        self.complete_breaths(recording).map(drop)
    }

    /// The complete breaths of a recording.
    ///
    /// # Errors
    /// A breath that the safe state ended, or too few complete breaths.
    fn complete_breaths(&self, recording: &Recording) -> Result<Vec<Episode>, PipelineError> {
        let breaths = episodes(recording, &self.shape(recording.provenance.period_us, 1).timing);
        // A breath that ended early has no later phase. One with a lost row is left out, but was not ended.
        let ended_early =
            |rows: &Range<usize>| recording.phase[rows.clone()].iter().all(|phase| *phase == INSPIRATION);
        let aborts = recording.breaths().iter().filter(|rows| ended_early(rows)).count();
        if aborts > 0 {
            return Err(Problem::Aborted(aborts).into());
        }
        if breaths.len() < BREATHS_NEEDED {
            return Err(PipelineError::TooFewBreaths { found: breaths.len(), needed: BREATHS_NEEDED });
        }
        Ok(breaths)
    }

    /// Fits a simulator; none if stopped.
    fn fitted(
        &self,
        shape: UnitConfig,
        breaths: &[&Episode],
        name: &str,
        task: &Task<'_>,
    ) -> Option<Simulator> {
        let mut fit = Fit::new(Architecture::Unit(shape), breaths, self.fit, None);
        while fit.epoch().is_some() {
            if task.stopped() {
                return None;
            }
            task.advance(1);
        }
        let mut simulator = fit.simulator(name);
        spread::normalise(&mut simulator.parameters);
        Some(simulator)
    }

    /// Trains a controller further on units around the fitted ones: one unit, or several with which one controller is to work.
    ///
    /// # Errors
    /// No unit, or a controller or a checkpoint that is not valid.
    pub fn tune(
        &self,
        start: &Residual,
        units: &[&Simulator],
        folder: Option<&Workspace>,
        progress: &Progress<'_>,
    ) -> Result<Commissioned, PipelineError> {
        let noises = units.iter().map(|unit| unit.noise);
        let (Some(least), Some(most)) = (noises.clone().reduce(f32::min), noises.reduce(f32::max)) else {
            return Err(PipelineError::NoSimulator);
        };
        let noise = (self.noise.0 * least, self.noise.1 * most + f32::EPSILON);
        let config = FamilyConfig { noise, seed: seeds::training(self.seed, 0), ..self.train.clone() };
        let weights: Vec<f32> = start.network().parameters().copied().collect();
        let models = self.models(units, start.spec().period_us);
        let training = FamilyTraining::new(*start.spec(), models, config, Some(&weights))?;
        let (before, _) = training.checkpoint().best;
        let plants: Vec<&str> = units.iter().map(|unit| unit.plant.as_str()).collect();
        let folder = folder.map(|folder| of_round(folder, 0));
        let trained = train(training, plants.join(", "), self.seed, folder.as_ref(), progress)?;
        let TrainedOnce { learned, improved, curve, complete } = trained;
        let winner = match (improved, learned.origin.validation < before) {
            (false, _) => Winner::Pid,
            (true, false) => Winner::Start,
            (true, true) => Winner::FineTuned,
        };
        Ok(Commissioned { learned, winner, start: before, curve, complete })
    }

    /// Units drawn around the fitted ones, about as many around each.
    fn models(&self, units: &[&Simulator], period_us: u32) -> FamilyModels {
        let mut rng = ChaCha8Rng::seed_from_u64(seeds::training(self.seed, 1));
        let mut drawn = |count: usize| {
            let each = count.div_ceil(units.len());
            let around = |unit: &&Simulator| spread::around(&unit.parameters, each, &self.around, &mut rng);
            let parameters: Vec<f32> = units.iter().flat_map(around).collect();
            Model::new(Architecture::Unit(self.shape(period_us, each * units.len())), &parameters)
        };
        FamilyModels { trained_on: drawn(self.drawn.0), held_out: drawn(self.drawn.1) }
    }

    /// The shape of a simulator of this number of units.
    fn shape(&self, period_us: u32, units: usize) -> UnitConfig {
        UnitConfig::for_breaths(period_us, units, &self.collect.settings)
    }
}

#[cfg(test)]
mod tests;
