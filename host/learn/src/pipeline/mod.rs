//! Rounds of collect, fit and train: from one or several ventilators to one learned controller.
//!
//! In the first round a known-good PID explores, in later ones the controller learned so far. Each round adds to
//! the recording, fits an ensemble of simulators to all of it (the last member is held out of training and
//! judges the controller), and trains the controller further.
//!
//! With a folder, every stage leaves its result there and a run that was stopped goes on where it was; it then
//! gives the same files as one that was not.

mod folder;
mod stages;
mod training;

use serde::{Deserialize, Serialize};
use shared::breath::{DEFAULT_PERIOD_US, PAPER_PIPS};
use shared::control::features::FeatureSpec;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::{ResidualError, ResidualSpec};
use shared::control::{COMMAND_MAX, Controller};
use shared::device::KNOWN_GOOD;
use shared::explore::Exploration;
use shared::settings::Settings;
use thiserror::Error;

use crate::controller::learned::{Learned, LearnedError};
use crate::controller::{CurvePoint, TrainConfig};
use crate::simulator::Timing;
use crate::simulator::fit::FitConfig;
use crate::simulator::model::{Architecture, Simulator};
use crate::simulator::open_loop::OpenLoop;
use crate::simulator::state_space::StateSpaceConfig;
use crate::simulator::stitched::StitchedConfig;
use data::recording::{DatasetError, Recording};
use data::tensors::TensorError;
use plant::bench::BenchConfig;
use progress::Progress;
use ventilator::collect::{CollectConfig, CollectError};
use ventilator::{BenchSource, PlantSource, SharedLink, Source, SourceError};

pub use folder::Folder;
pub use training::{TrainedOnce, train, train_on_simulators};

/// Control period of the paper's authors, microseconds.
pub const PAPER_PERIOD_US: u32 = 30_000;
/// Time constant of the authors' leaky integral with its sample, s: their integral gain of 1 acts, at first,
/// like 1/0.53 %/(cmH2O s) of ours.
pub const AUTHORS_INTEGRAL_S: f32 = 0.53;
/// Their PEEP, cmH2O.
pub const PAPER_PEEP: f32 = 5.0;
/// Gains of the PID with which they record: percent per cmH2O, and percent per cmH2O of a leaky integral.
const PAPER_GAINS: (f32, f32) = (3.0, 4.0);

/// What to run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PipelineConfig {
    /// Control period, microseconds.
    pub period_us: u32,
    /// Seed of everything.
    pub seed: u64,
    /// Rounds of collect, fit, train.
    pub rounds: usize,
    /// Gains of the PID that collects first and lies under the residual.
    pub gains: PidGains,
    /// Gains of the PID that collects first, if not that under the residual.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub collector: Option<PidGains>,
    /// What the network sees, if not what suits the control period.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub features: Option<FeatureSpec>,
    /// Scale of the residual.
    pub lambda: f32,
    /// Largest residual, percent.
    pub authority: f32,
    /// Simulators that the controller trains on; one more is fitted and held out.
    pub ensemble: usize,
    /// One in so many breaths is held out of fitting.
    pub hold_out: usize,
    /// Simulator's architecture.
    pub architecture: Architecture,
    /// Collection of each round.
    pub collect: CollectConfig,
    /// Fit of the first round.
    pub fit: FitConfig,
    /// Share of the first fit's epochs and learning rate that a later one takes, starting from its result.
    pub refit_share: f32,
    /// Training of each round.
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

    /// The setting of the paper's authors (Suo et al. 2021, and the constants of their code): a control period of 30 ms,
    /// PEEP 5 cmH2O, 20 breaths a minute with an inspiration of 1 s, PIPs of 10 to 35 cmH2O, their exploration around
    /// their PID, their stitched simulator with their optimiser. Residual and training are ours; their integral leaks, ours
    /// starts as steeply.
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

    /// The PID under the residual.
    fn base(&self) -> Result<Controller, ResidualError> {
        Ok(Controller::Pid(Pid::new(self.gains, self.period_us)?))
    }

    /// The PID that collects first.
    fn collector(&self) -> Result<Controller, PipelineError> {
        let gains = self.collector.unwrap_or(self.gains);
        Ok(Controller::Pid(Pid::new(gains, self.period_us).map_err(ResidualError::from)?))
    }

    fn timing(&self) -> &Timing {
        self.architecture.timing()
    }
}

/// Why the pipeline cannot go on.
#[derive(Debug, Error)]
pub enum PipelineError {
    /// Nothing to learn from.
    #[error(
        "only {found} complete breaths were recorded, at least {needed} are needed; raise --breaths or check the plant"
    )]
    TooFewBreaths {
        /// Complete breaths.
        found: usize,
        /// Least number.
        needed: usize,
    },
    /// The folder belongs to another run.
    #[error("{0} holds a run with another seed or configuration; choose another folder or remove it")]
    OtherRun(String),
    /// The folder's bookkeeping cannot be read or written.
    #[error("{path}: {reason}")]
    Folder {
        /// File.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// Nothing to train on.
    #[error("name at least one simulator to train on")]
    NoSimulator,
    /// A simulator that no such controller can be trained on.
    #[error("simulator {number} {reason}")]
    Simulator {
        /// Which, from 1.
        number: usize,
        /// Why not.
        reason: String,
    },
    /// Stopped before there was a controller.
    #[error("stopped before the first controller was trained; the same command goes on from here")]
    Stopped,
    /// A plant failed while it was recorded.
    #[error(
        "{reason}; {breaths} whole breaths of this round are saved in {file}, and the same command records it anew"
    )]
    Interrupted {
        /// How.
        reason: SourceError,
        /// Complete breaths.
        breaths: usize,
        /// Where they are.
        file: String,
    },
    /// Collection.
    #[error(transparent)]
    Collect(#[from] CollectError),
    /// The source.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A recording.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A simulator's file.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// The controller.
    #[error(transparent)]
    Residual(#[from] ResidualError),
    /// A controller's file.
    #[error(transparent)]
    Learned(#[from] LearnedError),
}

/// What a round found out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Round {
    /// Complete breaths recorded in this round.
    pub breaths: usize,
    /// Breaths that the pressure limit ended.
    pub aborts: usize,
    /// Mean loss of each epoch, first ensemble member.
    pub fit_curve: Vec<f64>,
    /// Errors of each ensemble member (held-out member last) on held-out breaths, plant after plant.
    pub open_loop: Vec<OpenLoop>,
    /// Training curve.
    pub train_curve: Vec<CurvePoint>,
    /// Controller's score on the held-out simulator, cmH2O.
    pub validation: f64,
    /// PID's score on the held-out simulator, cmH2O.
    pub base: f64,
    /// Whether the residual beats its PID there.
    pub improved: bool,
}

/// What is known of a plant after a run.
#[derive(Clone, Debug)]
pub struct Studied {
    /// Everything recorded.
    pub recording: Recording,
    /// Simulators of the last round; the last one was held out.
    pub simulators: Vec<Simulator>,
}

/// What a run leaves.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Each plant, as the sources were given.
    pub plants: Vec<Studied>,
    /// The controller.
    pub learned: Learned,
    /// Round by round.
    pub rounds: Vec<Round>,
    /// One in so many breaths was held out of fitting.
    pub hold_out: usize,
    /// Whether all rounds were run.
    pub complete: bool,
}

/// Makes the source of a round from its seed.
pub type MakeSource<'a> = &'a (dyn Fn(u64) -> Result<Box<dyn Source>, SourceError> + Sync);

/// Runs the rounds on one or several plants, in memory or with a folder to go on from. Each plant has its own recording
/// and its own simulators; the controller is trained on all of them at once.
///
/// # Errors
/// The first stage that fails; files of earlier stages stay.
pub fn run(
    config: &PipelineConfig,
    sources: &[MakeSource<'_>],
    folder: Option<&Folder>,
    progress: &Progress<'_>,
) -> Result<Outcome, PipelineError> {
    if let Some(folder) = folder {
        folder.claim(config)?;
    }
    let mut run = stages::Run::new(config, sources, folder, progress);
    for round in 0..config.rounds.max(1) {
        if !run.round(round)? {
            break;
        }
    }
    run.outcome()
}

/// [`run`] on benches: a ventilator in this process on each.
///
/// # Errors
/// As [`run`], or a bench that is refused.
pub fn run_on_benches(
    config: &PipelineConfig,
    benches: &[BenchConfig],
    folder: Option<&Folder>,
    progress: &Progress<'_>,
) -> Result<Outcome, PipelineError> {
    let base = config.base()?;
    let (settings, period_us) = (&config.collect.settings, config.period_us);
    let make = |bench| {
        let base = base.clone();
        move |seed| -> Result<Box<dyn Source>, SourceError> {
            Ok(Box::new(BenchSource::new(bench, base.clone(), settings, period_us, seed)?))
        }
    };
    let sources: Vec<_> = benches.iter().map(make).collect();
    let sources: Vec<MakeSource<'_>> = sources.iter().map(|source| source as MakeSource<'_>).collect();
    run(config, &sources, folder, progress)
}

/// [`run`] on a plant behind the plant link. All rounds use one link: a plant need not know that there are several.
///
/// # Errors
/// As [`run`].
pub fn run_on_plant(
    config: &PipelineConfig,
    link: &SharedLink,
    folder: Option<&Folder>,
    progress: &Progress<'_>,
) -> Result<Outcome, PipelineError> {
    let base = config.base()?;
    let source = |seed| -> Result<Box<dyn Source>, SourceError> {
        Ok(Box::new(PlantSource::new(link.clone(), base.clone(), config.period_us, seed)))
    };
    run(config, &[&source], folder, progress)
}

#[cfg(test)]
mod tests;
