//! The recipe of a fit: which architecture suits a recording, which of its breaths are held out, and how long the fit
//! runs.

mod held_out;
#[cfg(test)]
mod tests;

use thiserror::Error;

pub use self::held_out::HeldOut;

use crate::pipeline::{PAPER_PEEP, PAPER_PERIOD_US};
use crate::simulator::episode::{Episode, channels, split, ventilators};
use crate::simulator::fit::{FIT, Fit, FitConfig};
use crate::simulator::hybrid::HybridConfig;
use crate::simulator::model::{Architecture, Simulator};
use crate::simulator::state_space::StateSpaceConfig;
use crate::simulator::stitched::StitchedConfig;
use data::identity::TestRun;
use data::recording::Recording;
use progress::Progress;
use ventilator::seeds;

/// Minimum number of passes over a recording, however large.
const LEAST_EPOCHS: usize = 300;
/// Maximum number of passes over a recording, however small.
const MOST_EPOCHS: usize = 3_000;
/// Shortest control period of the stitched architecture, microseconds: it steps one tick at a time, and its history of
/// five ticks must be longer than the valve's dead time.
const STITCHED_LEAST_US: u32 = 5_000;

/// The kinds of models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Our state-space model.
    StateSpace,
    /// Our model of many lungs.
    Hybrid,
    /// The stitched networks of the paper's authors.
    Stitched,
}

/// How to fit a recording; options left at `None` follow from the recording.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// Kind of model [default: hybrid if the recording names R and C, else state-space].
    pub kind: Option<Kind>,
    /// Passes over the recording.
    pub epochs: Option<usize>,
    /// Breaths per gradient step.
    pub batch: Option<usize>,
    /// State-space and hybrid: number of states.
    pub states: Option<usize>,
    /// State-space and hybrid: number of hidden units.
    pub hidden: Option<usize>,
    /// State-space and hybrid: number of past command blocks that a step sees.
    pub history: Option<usize>,
    /// One in this number of breaths of each lung or test run is held out.
    pub hold_out: usize,
    /// Lungs held out altogether.
    pub hold_out_lungs: Vec<HeldOut>,
    /// Seed of the initial parameters and the order of breaths.
    pub seed: u64,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            kind: None,
            epochs: None,
            batch: None,
            states: None,
            hidden: None,
            history: None,
            hold_out: 5,
            hold_out_lungs: Vec::new(),
            seed: 1,
        }
    }
}

/// Why a recording cannot be fitted.
#[derive(Debug, Error)]
pub enum RecipeError {
    /// A lung to hold out is not in the recording.
    #[error("no breath of the lung {lung}: the recording has {names}")]
    NoSuchLung {
        /// The lung to hold out.
        lung: HeldOut,
        /// The lungs in the recording.
        names: String,
    },
    /// Too few breaths to fit and to hold out some.
    #[error(
        "{breaths} complete inspirations are too few to fit and to hold out every {hold_out}th: record more, or lower \
         --hold-out"
    )]
    TooFewBreaths {
        /// Number of complete inspirations of the lungs to fit.
        breaths: usize,
        /// See [`Recipe::hold_out`].
        hold_out: usize,
    },
    /// The control period is too short for the stitched architecture, microseconds.
    #[error(
        "the stitched architecture needs a longer control period than this recording's {0} us: collect one with \
         --period-us {PAPER_PERIOD_US}, or fit state-space"
    )]
    FastTicks(u32),
    /// The hybrid needs R and C, which the recording does not name.
    #[error("the hybrid needs R and C of every lung, not in this recording: use --architecture state-space")]
    UnknownLungs,
    /// All commands of the inspiratory valve are 0.
    #[error(
        "the recording has no valve commands, from which a simulator predicts the pressure: give one that was made with \
         its commands (events of PIRDS have none)"
    )]
    NoCommands,
    /// The control period differs from that of the paper's authors, microseconds.
    #[error(
        "the recording's control period is {0} us, but paper-30ms needs {PAPER_PERIOD_US}: collect one with --period-us \
         {PAPER_PERIOD_US}, or omit --preset"
    )]
    NotPaperPeriod(u32),
    /// The PEEP differs from that of the paper's authors, cmH2O.
    #[error("the recording has breaths at PEEP {0} cmH2O: paper-30ms needs {PAPER_PEEP}, or omit --preset")]
    NotPaperPeep(f32),
    /// The loss became NaN or infinite.
    #[error("the fit diverged in epoch {0}: check the recording for jumps, or try another --seed")]
    Diverged(usize),
}

/// Checks whether a recording was made with the settings of the paper's authors, as far as it shows.
///
/// # Errors
/// The setting that differs.
pub fn check_paper_setting(recording: &Recording) -> Result<(), RecipeError> {
    let period_us = recording.provenance.period_us;
    if period_us != PAPER_PERIOD_US {
        return Err(RecipeError::NotPaperPeriod(period_us));
    }
    match recording.peep.iter().find(|peep| (**peep - PAPER_PEEP).abs() > f32::EPSILON) {
        Some(peep) => Err(RecipeError::NotPaperPeep(*peep)),
        None => Ok(()),
    }
}

/// Breaths by their use.
#[derive(Clone, Debug)]
pub struct Parts<'a> {
    /// Breaths to fit.
    pub training: Vec<&'a Episode>,
    /// Breaths to score with.
    pub held_out: Vec<&'a Episode>,
    /// Breaths of lungs held out altogether.
    pub other_lungs: Vec<&'a Episode>,
}

/// A simulator with the loss of every epoch, cmH2O.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The simulator.
    pub simulator: Simulator,
    /// Mean loss by epoch.
    pub curve: Vec<f64>,
    /// Whether it was stopped before its last epoch.
    pub stopped: bool,
}

impl Recipe {
    /// The requested kind, or the one that best uses the information in the recording.
    pub fn kind(&self, recording: &Recording) -> Kind {
        self.kind.unwrap_or(if recording.names_lungs() { Kind::Hybrid } else { Kind::StateSpace })
    }

    /// The architecture for a recording.
    ///
    /// # Errors
    /// A kind that does not suit the recording.
    pub fn architecture(&self, recording: &Recording) -> Result<Architecture, RecipeError> {
        let period_us = recording.provenance.period_us;
        if !recording.is_empty() && recording.u_in.iter().all(|command| *command == 0.0) {
            return Err(RecipeError::NoCommands);
        }
        match self.kind(recording) {
            Kind::Stitched if period_us < STITCHED_LEAST_US => Err(RecipeError::FastTicks(period_us)),
            Kind::Stitched => Ok(Architecture::Stitched(StitchedConfig::for_period(period_us))),
            Kind::StateSpace => {
                let shape = StateSpaceConfig::for_period(period_us, channels(recording));
                Ok(Architecture::StateSpace(StateSpaceConfig {
                    lungs: many_lungs(recording),
                    states: self.states.unwrap_or(shape.states),
                    hidden: self.hidden.unwrap_or(shape.hidden),
                    history: self.history.unwrap_or(shape.history),
                    ..shape
                }))
            }
            Kind::Hybrid if !recording.names_lungs() => Err(RecipeError::UnknownLungs),
            Kind::Hybrid => {
                let shape = HybridConfig::for_period(period_us, channels(recording));
                Ok(Architecture::Hybrid(HybridConfig {
                    states: self.states.unwrap_or(shape.states),
                    hidden: self.hidden.unwrap_or(shape.hidden),
                    history: self.history.unwrap_or(shape.history),
                    ventilators: ventilators(recording).into_iter().max().map_or(0, |last| last as usize + 1),
                    groups: recording.provenance.groups.len(),
                    ..shape
                }))
            }
        }
    }

    /// Splits the breaths of a recording with these groups into those to fit and those to score with.
    ///
    /// # Errors
    /// A lung to hold out that is not in the recording, or too few breaths.
    pub fn parts<'a>(&self, all: &'a [Episode], groups: &[TestRun]) -> Result<Parts<'a>, RecipeError> {
        for lung in &self.hold_out_lungs {
            if !all.iter().any(|episode| lung.has(episode, groups)) {
                return Err(RecipeError::NoSuchLung { lung: lung.clone(), names: lungs(all, groups) });
            }
        }
        let other_lung = |e: &&Episode| self.hold_out_lungs.iter().any(|lung| lung.has(e, groups));
        // Counts every breath in its group, whether or not its lung is held out.
        let (mut training, mut held_out) = split(all, self.hold_out);
        training.retain(|episode| !other_lung(episode));
        held_out.retain(|episode| !other_lung(episode));
        let parts = Parts { training, held_out, other_lungs: all.iter().filter(other_lung).collect() };
        if parts.training.is_empty() || parts.held_out.is_empty() {
            let breaths = all.len() - parts.other_lungs.len();
            return Err(RecipeError::TooFewBreaths { breaths, hold_out: self.hold_out });
        }
        Ok(parts)
    }

    /// The configuration for this number of breaths: a small recording needs more passes, because gradient steps count.
    pub fn config(&self, architecture: &Architecture, breaths: usize) -> FitConfig {
        let (base, steps) = architecture.fitting();
        let batch = self.batch.unwrap_or(base.batch);
        let of_steps = |steps: usize| (steps * batch / breaths.max(1)).clamp(LEAST_EPOCHS, MOST_EPOCHS);
        let epochs = self.epochs.unwrap_or_else(|| steps.map_or(base.epochs, of_steps));
        FitConfig { epochs, batch, seed: seeds::training(self.seed, 0), ..base }
    }

    /// Fits an architecture to the training breaths of a recording; a stopped fit returns the simulator trained so far.
    ///
    /// # Errors
    /// The fit diverges.
    pub fn fit(
        &self,
        architecture: Architecture,
        recording: &Recording,
        training: &[&Episode],
        progress: &Progress<'_>,
    ) -> Result<Fitted, RecipeError> {
        let lessons = architecture.lessons(recording, training);
        let config = self.config(&architecture, lessons.len());
        let mut fit = Fit::new(architecture, &lessons.iter().collect::<Vec<_>>(), config, None);
        let task = progress.task(FIT, config.epochs);
        let mut curve = Vec::with_capacity(config.epochs);
        while !task.stopped() {
            let Some(loss) = fit.epoch() else { break };
            if !loss.is_finite() {
                return Err(RecipeError::Diverged(curve.len()));
            }
            curve.push(loss);
            task.advance(1);
        }
        let stopped = curve.len() < config.epochs;
        Ok(Fitted { simulator: fit.simulator(&recording.provenance.plant), curve, stopped })
    }
}

/// The lungs of these breaths, as text.
fn lungs(episodes: &[Episode], groups: &[TestRun]) -> String {
    let mut names: Vec<_> = episodes.iter().filter_map(|e| e.lung).map(|lung| lung.to_string()).collect();
    names.sort();
    names.dedup();
    names.extend(groups.iter().map(TestRun::to_string));
    if names.is_empty() { "neither R and C nor names".to_owned() } else { names.join(", ") }
}

/// Whether a recording names more than one lung.
fn many_lungs(recording: &Recording) -> bool {
    (1..recording.len()).any(|row| recording.lung(row) != recording.lung(0))
}
