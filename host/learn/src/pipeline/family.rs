//! From recorded units of a family to one controller for all of them.
//!
//! Some units of the family breathe under the known-good PID and explore, and so does the nominal machine with several lungs. A
//! physical simulator is fitted to the recordings; units that nobody has recorded are drawn around the fitted ones; the controller
//! is trained on those, from breath to breath. Further recorded units validate it; in validation as in training, half of the machines are
//! the nominal one. The nominal machine is what a user is most likely to
//! have, so a share of the training belongs to it.
//!
//! With a folder, every fitted unit and the training's checkpoints are saved there, and a stopped run continues.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::features::FeatureSpec;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::{Residual, ResidualError, ResidualSpec};
use shared::control::{COMMAND_MAX, Controller};
use shared::device::KNOWN_GOOD;

use super::{PipelineError, TrainedOnce, of_round, train};
use crate::controller::{FamilyConfig, FamilyModels, FamilyTraining};
use crate::simulator::episode::{Episode, episodes};
use crate::simulator::fit::{Fit, FitConfig};
use crate::simulator::model::{Architecture, Model, Simulator};
use crate::simulator::unit::{UnitConfig, spread};
use data::workspace::Workspace;
use engine::adam::AdamConfig;
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use plant::prescriptions::Prescriptions;
use progress::{Progress, Stage};
use ventilator::collect::{CollectConfig, collect};
use ventilator::{BenchSource, seeds};

/// Recording units of a family and fitting their simulators: units.
pub const UNITS: Stage = Stage("record and fit units");

/// Ticks of an inspiration that are fitted: on a longer plateau nothing happens that a unit's numbers would follow from.
const FITTED_TICKS: usize = 1000;

/// Configuration of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FamilyRun {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of units to record and train on.
    pub units: u32,
    /// Number of further units to record, for validation.
    pub held_out: u32,
    /// Number of lungs of the family to record on the nominal machine.
    pub nominal: u32,
    /// Share of the machines drawn for the training that are nominal ones.
    pub nominal_share: f32,
    /// Share of the drawn lungs whose resistance and compliance are moved to the ends of the recorded ones.
    pub extreme_share: f32,
    /// Number of units drawn around the recorded ones, to train and to validate on.
    pub drawn: (usize, usize),
    /// Gains of the PID that records.
    pub collector: PidGains,
    /// Gains of the PID under the residual: soft, because it must suit every unit.
    pub gains: PidGains,
    /// Each unit's recording.
    pub collect: CollectConfig,
    /// Each unit's fit.
    pub fit: FitConfig,
    /// Training; its range of noise follows from the recordings.
    pub train: FamilyConfig,
    /// Parameters of a trained network to start from: see [`Self::start_from`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<Vec<f32>>,
}

impl Default for FamilyRun {
    fn default() -> Self {
        let adam = AdamConfig { rate: 0.03, final_share: 0.02, weight_decay: 0.0, clip: 1.0 };
        Self {
            seed: 1,
            units: 64,
            held_out: 16,
            nominal: 16,
            nominal_share: 0.5,
            extreme_share: 0.3,
            drawn: (4096, 512),
            collector: KNOWN_GOOD,
            gains: PidGains { p: 3.0, i: 8.0, d: 0.08 },
            collect: CollectConfig { breaths: 64, ..CollectConfig::default() },
            // All breaths in every gradient step: a unit has few numbers and many breaths.
            fit: FitConfig { epochs: 300, batch: 1024, adam, ..FitConfig::default() },
            train: FamilyConfig::default(),
            start: None,
        }
    }
}

/// The settings that must match to continue a stopped run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Claim {
    run: FamilyRun,
    /// The family's first unit, which shows whether the ranges are the same.
    first: BenchConfig,
}

/// Simulators of the recorded units, those for validation last, and of the nominal machine.
pub struct FittedUnits {
    units: Vec<Simulator>,
    nominal: Simulator,
}

impl FamilyRun {
    /// The default for a family and these prescriptions.
    pub fn of(family: &Family, prescriptions: &Prescriptions) -> Self {
        let mut run = Self::default();
        run.train.usual = Prescriptions::listed("usual", &family.pips, family.settings);
        run.train.prescriptions = prescriptions.clone();
        run.gains = family.soft_pid.unwrap_or(run.gains);
        (run.collect.settings, run.collect.pip_range) = (family.settings, run.train.usual.pip_range());
        run.collect.pips.clone_from(&family.pips);
        run.collect.prescriptions = (!prescriptions.are_listed()).then(|| prescriptions.clone());
        run
    }

    /// Starts from a controller that was trained for another family, over the PID under its network.
    ///
    /// # Errors
    /// A controller with other features, another control period or another authority.
    pub fn start_from(&mut self, controller: &Residual) -> Result<(), PipelineError> {
        let gains = controller.spec().gains;
        if *controller.spec() != (ResidualSpec { gains, ..self.residual() }) {
            return Err(PipelineError::Start);
        }
        self.gains = gains;
        self.start = Some(controller.network().parameters().copied().collect());
        Ok(())
    }

    /// Records, fits and trains.
    ///
    /// # Errors
    /// A unit that cannot be recorded, a run stopped before its training, or a folder with another run.
    pub fn run(
        &self,
        family: &Family,
        folder: Option<&Workspace>,
        progress: &Progress<'_>,
    ) -> Result<TrainedOnce, PipelineError> {
        let first = family.draw(seeds::units(self.seed), 0);
        if let Some(folder) = folder {
            folder.claim(&Claim { run: self.clone(), first })?;
        }
        let folder = folder.map(|folder| of_round(folder, 0));
        let fitted = self.fit_units(family, folder.as_ref(), progress)?;
        self.train_on(&fitted, family, folder.as_ref(), progress)
    }

    /// Records the units and the nominal machine, and fits their simulators; those that the folder keeps stay as they are.
    ///
    /// # Errors
    /// A unit that cannot be recorded, or a run that is stopped.
    pub fn fit_units(
        &self,
        family: &Family,
        folder: Option<&Workspace>,
        progress: &Progress<'_>,
    ) -> Result<FittedUnits, PipelineError> {
        let units = self.units(family, folder, progress)?;
        let nominal = || self.nominal(family);
        let nominal = kept(folder, "nominal.safetensors", progress.stopped(), nominal)?
            .ok_or(PipelineError::Stopped)?;
        Ok(FittedUnits { units, nominal })
    }

    /// Trains on fitted units.
    ///
    /// # Errors
    /// A configuration that does not fit the units, or a checkpoint that cannot be written.
    pub fn train_on(
        &self,
        FittedUnits { units, nominal }: &FittedUnits,
        family: &Family,
        folder: Option<&Workspace>,
        progress: &Progress<'_>,
    ) -> Result<TrainedOnce, PipelineError> {
        let config =
            FamilyConfig { noise: noise(units), seed: seeds::training(self.seed, 0), ..self.train.clone() };
        let models = self.models(units, nominal);
        let training = FamilyTraining::new(self.residual(), models, config, self.start.as_deref())?;
        train(training, format!("family {}", family.name), self.seed, folder, progress)
    }

    /// The residual's fixed parts.
    fn residual(&self) -> ResidualSpec {
        ResidualSpec {
            period_us: DEFAULT_PERIOD_US,
            gains: self.gains,
            lambda: 1.0,
            authority: COMMAND_MAX,
            features: FeatureSpec::for_period(DEFAULT_PERIOD_US),
        }
    }

    /// A simulator of every recorded unit, those for validation last.
    fn units(
        &self,
        family: &Family,
        folder: Option<&Workspace>,
        progress: &Progress<'_>,
    ) -> Result<Vec<Simulator>, PipelineError> {
        let count = self.units + self.held_out;
        let task = progress.task(UNITS, count as usize);
        let unit = |number: u32| {
            let name = format!("unit-{number}.safetensors");
            let simulator = kept(folder, &name, task.stopped(), || self.fitted(number, family))?;
            task.advance(usize::from(simulator.is_some()));
            Ok(simulator)
        };
        let units: Result<Vec<_>, PipelineError> = (0..count).into_par_iter().map(unit).collect();
        units?.into_iter().collect::<Option<_>>().ok_or(PipelineError::Stopped)
    }

    /// Records a unit and fits its simulator.
    fn fitted(&self, number: u32, family: &Family) -> Result<Simulator, PipelineError> {
        let bench = family.draw(seeds::units(self.seed), number);
        let breaths = self.breaths(number, &bench, 0)?;
        Ok(self.fit(1, &breaths, &bench.name))
    }

    /// Records the nominal machine with several lungs and fits its simulator: all breaths share the valve of its first unit.
    fn nominal(&self, family: &Family) -> Result<Simulator, PipelineError> {
        let machine = family.nominal();
        let first = self.units + self.held_out;
        let of_lung = |n: u32| {
            let lung = family.draw(seeds::units(self.seed), first + n).lung;
            self.breaths(first + n, &BenchConfig { lung, ..machine.clone() }, n)
        };
        let breaths: Vec<Vec<Episode>> =
            (0..self.nominal).into_par_iter().map(of_lung).collect::<Result<_, PipelineError>>()?;
        Ok(self.fit(self.nominal as usize, &breaths.concat(), &machine.name))
    }

    /// Records breaths of a bench under the known-good PID, for the lung of this unit of a simulator.
    fn breaths(&self, number: u32, bench: &BenchConfig, lung: u32) -> Result<Vec<Episode>, PipelineError> {
        let seed = seeds::collection(self.seed, u64::from(number));
        let pid = Controller::Pid(Pid::new(self.collector, DEFAULT_PERIOD_US).map_err(ResidualError::from)?);
        let settings = &self.collect.settings;
        let mut source = BenchSource::new(bench, pid.clone(), settings, DEFAULT_PERIOD_US, seed)?;
        let config = CollectConfig { seed, ..self.collect.clone() };
        let recording = collect(&mut source, &pid, &config, &Progress::silent())?.recording;
        let mut breaths = episodes(&recording, &self.shape(1).timing);
        for breath in &mut breaths {
            breath.cut(FITTED_TICKS);
            (breath.ventilator, breath.group) = (Some(0), Some(lung));
        }
        Ok(breaths)
    }

    /// The shape of a simulator of this number of units, in the breaths of the collection.
    fn shape(&self, units: usize) -> UnitConfig {
        UnitConfig::for_breaths(DEFAULT_PERIOD_US, units, &self.collect.settings)
    }

    /// Fits a simulator of this number of lungs.
    fn fit(&self, lungs: usize, breaths: &[Episode], name: &str) -> Simulator {
        let shape = self.shape(lungs);
        let breaths: Vec<&Episode> = breaths.iter().collect();
        let mut fit = Fit::new(Architecture::Unit(shape), &breaths, self.fit, None);
        while fit.epoch().is_some() {}
        let mut simulator = fit.simulator(name);
        if lungs == 1 {
            spread::normalise(&mut simulator.parameters);
        }
        simulator
    }

    /// Units drawn around the recorded ones.
    fn models(&self, units: &[Simulator], nominal: &Simulator) -> FamilyModels {
        let (trained_on, held_out) = units.split_at(self.units as usize);
        let mut rng = ChaCha8Rng::seed_from_u64(seeds::training(self.seed, 1));
        let mut model = |units: &[Simulator], count: usize| {
            let recorded: Vec<f32> = units.iter().flat_map(|unit| unit.parameters.clone()).collect();
            let parameters = self.draw(&recorded, &nominal.parameters, count, &mut rng);
            Model::new(Architecture::Unit(self.shape(count)), &parameters)
        };
        FamilyModels { trained_on: model(trained_on, self.drawn.0), held_out: model(held_out, self.drawn.1) }
    }

    /// Parameters of this number of units, with the shares of nominal machines and extreme lungs.
    fn draw(&self, recorded: &[f32], nominal: &[f32], count: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let share = |share: f32| (share * count as f32) as usize;
        let mut parameters = spread::draw(recorded, count, rng);
        spread::put_machine(nominal, &mut parameters, share(self.nominal_share), rng);
        spread::put_extremes(recorded, &mut parameters, share(self.extreme_share), rng);
        parameters
    }
}

/// The simulator that the folder keeps under a name or, if there is none, a new one, which is then kept; none if the run was stopped
/// before.
fn kept(
    folder: Option<&Workspace>,
    name: &str,
    stopped: bool,
    fit: impl FnOnce() -> Result<Simulator, PipelineError>,
) -> Result<Option<Simulator>, PipelineError> {
    let file = folder.map(|folder| folder.path(name));
    if let Some(file) = file.as_ref().filter(|file| file.exists()) {
        return Ok(Some(Simulator::load(file)?));
    }
    if stopped {
        return Ok(None);
    }
    let simulator = fit()?;
    file.map_or(Ok(()), |file| simulator.save(&file))?;
    Ok(Some(simulator))
}

/// Range of the sensor noise of these units, standard deviation, cmH2O.
fn noise(units: &[Simulator]) -> (f32, f32) {
    let ends = units
        .iter()
        .fold((f32::INFINITY, 0.0_f32), |(low, high), unit| (low.min(unit.noise), high.max(unit.noise)));
    // The range must not be empty.
    (ends.0, ends.1.max(ends.0 + f32::EPSILON))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::open_loop::open_loop;
    use crate::simulator::unit::PER_UNIT;
    use shared::control::network::Network;
    use ventilator::collect::IN_A_ROW;

    #[test]
    fn the_familys_soft_pid_lies_under_the_residual() {
        let text = "[family.valve]\nlag_ms = { uniform = [15, 45] }\n";
        let gains =
            |text: &str| FamilyRun::of(&Family::from_toml(text).unwrap(), &Prescriptions::default()).gains;
        assert_eq!(gains(text), FamilyRun::default().gains);
        let soft = gains(&format!("{text}[soft_pid]\np = 1\ni = 2\nd = 0"));
        assert_eq!(soft, PidGains { p: 1.0, i: 2.0, d: 0.0 });
    }

    #[test]
    fn a_start_brings_its_network_and_the_pid_under_it_and_must_see_the_same() {
        let mut run = FamilyRun::default();
        let neonate = crate::controller::shipped::residual("neonate").unwrap();
        run.start_from(&neonate).unwrap();
        assert_eq!((run.gains, run.start.unwrap().len()), (neonate.spec().gains, Network::PARAMETERS));
        let weak = ResidualSpec { authority: 50.0, ..*neonate.spec() };
        let weak = Residual::new(weak, neonate.network().clone()).unwrap();
        assert!(matches!(FamilyRun::default().start_from(&weak), Err(PipelineError::Start)));
    }

    /// Open-loop distance to the true pressure on fresh breaths of the first units, breaths after a change of settings included.
    fn distances(run: &FamilyRun, family: &Family, units: &[Simulator], prescriptions: &str) -> Vec<f64> {
        let prescriptions = Some(Prescriptions::from_toml(prescriptions).unwrap());
        let collect = CollectConfig { breaths: 32, prescriptions, ..run.collect.clone() };
        let fresh = FamilyRun { seed: 77, collect, ..run.clone() };
        let of_unit = |(number, unit): (u32, &Simulator)| {
            let bench = family.draw(seeds::units(run.seed), number);
            let breaths = fresh.breaths(number, &bench, 0).unwrap();
            let drawn: Vec<&Episode> = breaths.chunks(IN_A_ROW).skip(1).step_by(2).flatten().collect();
            open_loop(unit, &drawn).truth.unwrap()
        };
        (0..).zip(units).map(of_unit).collect()
    }

    #[test]
    fn units_are_right_at_every_prescription_that_they_were_recorded_at() {
        let family = Family::find("adult").unwrap();
        let run = FamilyRun::of(&family, &Prescriptions::find("bedside").unwrap());
        let units: Vec<Simulator> =
            (0..6).into_par_iter().map(|number| run.fitted(number, &family).unwrap()).collect();
        // Settings, and the largest mean distance, cmH2O.
        let rows = [
            ("[settings]\npeep = 5", 0.3),
            ("[settings]\npeep = 0", 0.4),
            ("[settings]\npeep = 10", 0.4),
            ("[settings]\npeep = 20", 0.8),
            ("[settings]\nrise_time = 0.4", 0.3),
            ("[settings]\ninspiratory_time = 0.4", 0.5),
            ("[settings]\ninspiratory_time = 3\nrate = 8", 0.3),
            ("[settings]\npip = 40\npressure_limit = 80\n[drawn]\npip = { uniform = [45, 55] }", 1.2),
        ];
        for (settings, bound) in rows {
            let drawn = if settings.contains("drawn") {
                ""
            } else {
                "\n[drawn]\ndriving_pressure = { uniform = [5, 25] }"
            };
            let found = distances(&run, &family, &units, &format!("{settings}{drawn}"));
            let mean = found.iter().sum::<f64>() / found.len() as f64;
            println!("{settings:?}: {mean:.3}");
            assert!(mean < bound, "{settings}: {mean}, {found:?}");
        }
    }

    #[test]
    fn drawn_units_have_the_configured_shares_of_nominal_machines_and_extreme_lungs() {
        // Machines and lungs that differ from unit to unit, and a nominal machine far from all of them.
        let mut recorded = UnitConfig::for_period(1000, 20).initialise();
        for (n, parameter) in recorded.iter_mut().enumerate() {
            *parameter += 0.1 * (n as f32).sin();
        }
        let mut nominal = UnitConfig::for_period(1000, 1).initialise();
        nominal[0] += 5.0;
        let drawn = |nominal_share, extreme_share| {
            let run = FamilyRun { nominal_share, extreme_share, ..FamilyRun::default() };
            run.draw(&recorded, &nominal, 900, &mut ChaCha8Rng::seed_from_u64(1))
        };
        let (usual, mixed) = (drawn(0.0, 0.0), drawn(0.5, 0.3));
        let on_nominal = |units: &[f32]| {
            units.chunks_exact(PER_UNIT).filter(|unit| (unit[0] - nominal[0]).abs() < 1.0).count()
        };
        assert_eq!((on_nominal(&usual), on_nominal(&mixed)), (0, 450));
        // A blurred number is that of a recorded unit only if it was put there.
        let extreme = |units: &[f32]| {
            let is_recorded = |(place, number): (usize, &f32)| {
                recorded.iter().skip(place).step_by(PER_UNIT).any(|known| known.to_bits() == number.to_bits())
            };
            units.chunks_exact(PER_UNIT).filter(|unit| unit.iter().enumerate().any(is_recorded)).count()
        };
        // Of the extreme lungs, a ninth keeps both numbers.
        let found = extreme(&mixed) - extreme(&usual);
        assert!((220..=265).contains(&found), "{found} of 270");
    }
}
