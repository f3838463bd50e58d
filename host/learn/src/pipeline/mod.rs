//! Rounds of collect, fit and train: from one or several ventilators to one learned controller.
//!
//! A known-good PID explores in the first round, the controller learned so far in later ones. Each round adds to the
//! recording, fits an ensemble of simulators to all of it (the last member is held out of training and judges the
//! controller), and trains the controller further.
//!
//! With a folder, every stage saves its result there, and a stopped run continues where it stopped; it then gives the
//! same files as an uninterrupted run.
//!
//! ```text
//! run.json                     configuration; a run with a different one is refused
//! round-0/recording-P.parquet  breaths of the round, from plant P
//! round-0/recording-P.partial.parquet  the breaths before the plant failed
//! round-0/simulator-P-N.safetensors, round-0/fit.json
//! round-0/training.json        checkpoint of the training
//! round-0/controller.safetensors
//! ```

pub mod commission;
pub mod family;
mod stages;
mod training;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use shared::breath::{DEFAULT_PERIOD_US, PAPER_PIPS};
use shared::control::features::FeatureSpec;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::{Residual, ResidualError, ResidualSpec};
use shared::control::{COMMAND_MAX, Controller};
use shared::device::KNOWN_GOOD;
use shared::explore::Exploration;
use shared::settings::Settings;
use thiserror::Error;

use crate::controller::learned::{Learned, LearnedError};
use crate::controller::{ControllerArchitecture, CurvePoint, TrainConfig, Trainable};
use crate::simulator::Timing;
use crate::simulator::fit::FitConfig;
use crate::simulator::model::{Architecture, Simulator};
use crate::simulator::open_loop::OpenLoop;
use crate::simulator::state_space::StateSpaceConfig;
use crate::simulator::stitched::StitchedConfig;
use data::recording::{DatasetError, Recording};
use data::tensors::TensorError;
use data::workspace::{Workspace, WorkspaceError};
use plant::Plant;
use plant::bench::BenchConfig;
use plant::prescriptions::Prescriptions;
use progress::Progress;
use ventilator::collect::{CollectConfig, CollectError};
use ventilator::{BenchSource, PlantSource, SharedLink, Source, SourceError};

pub use training::{TrainedOnce, checksum, train, train_on_simulators};

/// Control period of the paper's authors, microseconds.
pub const PAPER_PERIOD_US: u32 = 30_000;
/// Time constant of the authors' leaky integral with its sample, s: their integral gain of 1 initially acts like 1/0.53
/// %/(cmH2O s) of ours.
pub const AUTHORS_INTEGRAL_S: f32 = 0.53;
/// The authors' PEEP, cmH2O.
pub const PAPER_PEEP: f32 = 5.0;
/// Gains of the authors' recording PID: percent per cmH2O, and percent per cmH2O of a leaky integral.
const PAPER_GAINS: (f32, f32) = (3.0, 4.0);

/// Configuration of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PipelineConfig {
    /// Control period, microseconds.
    pub period_us: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of rounds of collect, fit and train.
    pub rounds: usize,
    /// Gains of the PID that collects first and lies under the residual.
    pub gains: PidGains,
    /// Gains of the PID that collects first, if they differ from those under the residual.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub collector: Option<PidGains>,
    /// The network's features, if not the defaults for the control period.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub features: Option<FeatureSpec>,
    /// Architecture of the controller.
    #[serde(skip_serializing_if = "ControllerArchitecture::is_ours")]
    pub controller: ControllerArchitecture,
    /// Scale of the residual.
    pub lambda: f32,
    /// Largest residual, percent of the valve.
    pub authority: f32,
    /// Number of simulators that the controller trains on; one more is fitted and held out.
    pub ensemble: usize,
    /// One in this number of breaths is held out of fitting.
    pub hold_out: usize,
    /// Architecture of the simulators.
    pub architecture: Architecture,
    /// Configuration of each round's collection.
    pub collect: CollectConfig,
    /// Configuration of the first round's fit.
    pub fit: FitConfig,
    /// Share of the first fit's epochs and learning rate used by later fits, which start from its result.
    pub refit_share: f32,
    /// Configuration of each round's training.
    pub train: TrainConfig,
}

impl Default for PipelineConfig {
    fn default() -> Self {
        Self::for_period(DEFAULT_PERIOD_US)
    }
}

impl PipelineConfig {
    /// Defaults for a control period in microseconds.
    pub fn for_period(period_us: u32) -> Self {
        Self {
            period_us,
            seed: 1,
            rounds: 3,
            gains: KNOWN_GOOD,
            collector: None,
            features: None,
            controller: ControllerArchitecture::Ours,
            lambda: 1.0,
            authority: COMMAND_MAX,
            ensemble: 2,
            hold_out: 8,
            architecture: Architecture::StateSpace(StateSpaceConfig::for_period(period_us, 1)),
            collect: CollectConfig { breaths: 120, ..CollectConfig::default() },
            fit: FitConfig::default(),
            refit_share: 0.4,
            train: TrainConfig::default(),
        }
    }

    /// The settings of the paper's authors (Suo et al. 2021, and the constants of their code): a control period of 30
    /// ms, PEEP 5 cmH2O, 20 breaths a minute with an inspiration of 1 s, PIPs of 10 to 35 cmH2O, their exploration
    /// around their PID, and their stitched simulator with their optimiser. Residual and training are ours. Their
    /// integral leaks; ours has the same initial slope.
    pub fn paper_30ms() -> Self {
        let (p, leaky) = PAPER_GAINS;
        let gains = PidGains { p, i: leaky / AUTHORS_INTEGRAL_S, d: 0.0 };
        let mut config = Self { gains, fit: FitConfig::authors(), ..Self::for_period(PAPER_PERIOD_US) };
        config.architecture = Architecture::Stitched(StitchedConfig::for_period(PAPER_PERIOD_US));
        config.collect.pips = PAPER_PIPS.to_vec();
        config.collect.settings =
            Settings { peep: PAPER_PEEP, rate: 20.0, inspiratory_time: 1.0, ..Settings::default() };
        config.collect.exploration = Some(Exploration {
            boundary_probability: 0.15,
            boundary_height: (0.0, 100.0),
            boundary_duration: (0.05, 0.3),
            triangle_height: (-30.0, 30.0),
            triangle_duration: (0.1, 0.5),
            ..Exploration::default()
        });
        config
    }

    /// Records and trains with prescriptions too, if they are drawn.
    pub fn prescribe(&mut self, prescriptions: &Prescriptions) {
        let drawn = (!prescriptions.are_listed()).then(|| prescriptions.clone());
        self.collect.prescriptions.clone_from(&drawn);
        self.train.prescriptions = drawn;
    }

    /// The residual's fixed parts.
    pub fn residual(&self) -> ResidualSpec {
        ResidualSpec {
            period_us: self.period_us,
            gains: self.gains,
            lambda: self.lambda,
            authority: self.authority,
            features: self.features.unwrap_or_else(|| FeatureSpec::for_period(self.period_us)),
        }
    }

    /// The controller's fixed parts in the architecture `C`.
    fn specification<C: Trainable>(&self) -> Result<C::Spec, PipelineError> {
        C::specify(self.residual(), self.controller)
            .ok_or_else(|| PipelineError::Architecture(self.controller.name()))
    }

    /// The PID under the residual.
    fn base<C: Trainable>(&self) -> Result<C::Law, ResidualError> {
        C::pid_law(Pid::new(self.gains, self.period_us)?, self.period_us)
    }

    /// The PID that collects in the first round.
    fn collector<C: Trainable>(&self) -> Result<C::Law, PipelineError> {
        let gains = self.collector.unwrap_or(self.gains);
        let pid = Pid::new(gains, self.period_us).map_err(ResidualError::from)?;
        Ok(C::pid_law(pid, self.period_us)?)
    }

    fn timing(&self) -> &Timing {
        self.architecture.timing()
    }
}

/// Why the pipeline cannot continue.
#[derive(Debug, Error)]
pub enum PipelineError {
    /// Too few breaths were recorded to learn from.
    #[error(
        "only {found} complete breaths were recorded, but at least {needed} are needed: raise --breaths or check the plant"
    )]
    TooFewBreaths {
        /// Number of complete breaths.
        found: usize,
        /// Number of breaths needed.
        needed: usize,
    },
    /// The folder belongs to another run, or cannot be used.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
    /// A unit must not be commissioned.
    #[error(transparent)]
    Commission(#[from] commission::Problem),
    /// The configuration is for another architecture of the controller than the one to train.
    #[error(
        "the configuration asks for a controller of the architecture {0}, but another one was to be trained"
    )]
    Architecture(&'static str),
    /// A training for a family cannot start from this controller.
    #[error(
        "the controller to start from has other features, another control period or another authority than those that are trained for a family"
    )]
    Start,
    /// No simulator to train on was given.
    #[error("name at least one simulator to train on")]
    NoSimulator,
    /// A simulator is unsuitable for this controller.
    #[error("simulator {number} {reason}")]
    Simulator {
        /// Number of the simulator, from 1.
        number: usize,
        /// Why it is unsuitable.
        reason: String,
    },
    /// Stopped before the first controller was trained.
    #[error("stopped before the first controller was trained; run the same command again to continue")]
    Stopped,
    /// A plant failed during recording.
    #[error(
        "{reason}; {breaths} complete breaths of this round are saved in {file}; run the same command again to repeat the round"
    )]
    Interrupted {
        /// The failure.
        reason: SourceError,
        /// Number of complete breaths.
        breaths: usize,
        /// Path of the file that contains them.
        file: String,
    },
    /// The collection failed.
    #[error(transparent)]
    Collect(#[from] CollectError),
    /// The source failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A recording could not be read or written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A simulator's file could not be read or written.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// The controller is not valid.
    #[error(transparent)]
    Residual(#[from] ResidualError),
    /// A controller's file could not be read or written.
    #[error(transparent)]
    Learned(#[from] LearnedError),
}

/// Results of a round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Round {
    /// Complete breaths recorded in this round.
    pub breaths: usize,
    /// Number of breaths ended early by the pressure limit.
    pub aborts: usize,
    /// Mean loss of each epoch, first ensemble member.
    pub fit_curve: Vec<f64>,
    /// Errors of each ensemble member on held-out breaths, plant by plant; the held-out member is last.
    pub open_loop: Vec<OpenLoop>,
    /// Training curve.
    pub train_curve: Vec<CurvePoint>,
    /// Score of the controller on the held-out simulator, cmH2O.
    pub validation: f64,
    /// Score of the PID on the held-out simulator, cmH2O.
    pub base: f64,
    /// Whether the residual beats its PID there.
    pub improved: bool,
}

/// The recording and simulators of a plant after a run.
#[derive(Clone, Debug)]
pub struct Studied {
    /// All recorded breaths.
    pub recording: Recording,
    /// Simulators of the last round; the last one was held out.
    pub simulators: Vec<Simulator>,
}

/// Results of a run.
#[derive(Clone, Debug)]
pub struct Outcome<C = Residual> {
    /// The plants, in the order of the sources.
    pub plants: Vec<Studied>,
    /// The controller.
    pub learned: Learned<C>,
    /// Results of each round.
    pub rounds: Vec<Round>,
    /// One in this number of breaths was held out of fitting.
    pub hold_out: usize,
    /// Whether all rounds were run.
    pub complete: bool,
}

/// Creates the source of a round from its seed.
pub type MakeSource<'a, L = Controller> = &'a (dyn Fn(u64) -> Result<Box<dyn Source<L>>, SourceError> + Sync);

/// The folder of a run. It continues only with the same plants.
#[derive(Clone, Debug)]
pub struct RunFolder<'a> {
    /// The folder.
    pub workspace: &'a Workspace,
    /// What each plant is, in the order of the sources.
    pub plants: Vec<Value>,
}

/// What must match to continue a stopped run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Claim {
    config: PipelineConfig,
    /// What each plant is.
    plants: Vec<Value>,
}

/// Runs the rounds for a controller of the architecture `C`, which the configuration must name, on one or several plants, in memory
/// or with a folder to continue from. Each plant has its own recording and simulators; the controller is trained on all of them at
/// once.
///
/// # Errors
/// The error of the first stage that fails; files of earlier stages stay.
pub fn run<C: Trainable>(
    config: &PipelineConfig,
    sources: &[MakeSource<'_, C::Law>],
    folder: Option<RunFolder<'_>>,
    progress: &Progress<'_>,
) -> Result<Outcome<C>, PipelineError> {
    config.specification::<C>()?;
    let workspace = folder.as_ref().map(|folder| folder.workspace);
    if let Some(RunFolder { workspace, plants }) = folder {
        workspace.claim(&Claim { config: config.clone(), plants })?;
    }
    let mut run = stages::Run::<C>::new(config, sources, workspace, progress);
    for round in 0..config.rounds.max(1) {
        if !run.round(round)? {
            break;
        }
    }
    run.outcome()
}

/// Like [`run`], on benches: a ventilator in this process on each.
///
/// # Errors
/// See [`run`]; also a bench that is refused.
pub fn run_on_benches<C: Trainable>(
    config: &PipelineConfig,
    benches: &[BenchConfig],
    folder: Option<&Workspace>,
    progress: &Progress<'_>,
) -> Result<Outcome<C>, PipelineError> {
    let base = config.base::<C>()?;
    let (settings, period_us) = (&config.collect.settings, config.period_us);
    let make = |bench| {
        let base = base.clone();
        move |seed| -> Result<Box<dyn Source<C::Law>>, SourceError> {
            Ok(Box::new(BenchSource::new(bench, base.clone(), settings, period_us, seed)?))
        }
    };
    let sources: Vec<_> = benches.iter().map(make).collect();
    let sources: Vec<MakeSource<'_, C::Law>> =
        sources.iter().map(|source| source as MakeSource<'_, C::Law>).collect();
    let folder = folder
        .map(|workspace| RunFolder { workspace, plants: benches.iter().map(|bench| json!(bench)).collect() });
    run(config, &sources, folder, progress)
}

/// Like [`run`], on a plant behind the plant link. All rounds share one link, so the plant need not accept several.
///
/// # Errors
/// See [`run`].
pub fn run_on_plant<C: Trainable>(
    config: &PipelineConfig,
    link: &SharedLink,
    folder: Option<&Workspace>,
    progress: &Progress<'_>,
) -> Result<Outcome<C>, PipelineError> {
    let base = config.base::<C>()?;
    let source = |seed| -> Result<Box<dyn Source<C::Law>>, SourceError> {
        Ok(Box::new(PlantSource::new(link.clone(), base.clone(), config.period_us, seed)))
    };
    let folder = folder.map(|workspace| RunFolder { workspace, plants: vec![json!(link.name())] });
    run(config, &[&source], folder, progress)
}

/// The part of a round in the folder of a run.
fn of_round(folder: &Workspace, round: usize) -> Workspace {
    folder.folder(&format!("round-{round}"))
}

#[cfg(test)]
mod tests;
