//! The recipe of a fit: which architecture makes the most of a recording, which of its breaths are held out, and for how
//! long it is fitted.

#[cfg(test)]
mod tests;

use thiserror::Error;

use crate::pipeline::{PAPER_PEEP, PAPER_PERIOD_US};
use crate::simulator::episode::{Episode, channels, split, ventilators, whole_breaths};
use crate::simulator::fit::{Fit, FitConfig};
use crate::simulator::hybrid::HybridConfig;
use crate::simulator::model::{Architecture, Simulator};
use crate::simulator::state_space::StateSpaceConfig;
use crate::simulator::stitched::StitchedConfig;
use data::identity::LungParameters;
use data::recording::Recording;
use progress::{Progress, Stage};
use ventilator::seeds;

/// Breaths per gradient step of the state-space model: on 160 breaths of the default lung, 16 in place of 64 bring the
/// open-loop distance from 0.26 to 0.18 cmH2O in the same number of epochs.
const BATCH: usize = 16;
/// Decay of the hybrid's weights: of 0.005, 0.02 and 0.05 it did best on lungs left out one by one.
const HYBRID_DECAY: f32 = 0.005;
/// Gradient steps by which that distance has stopped falling fast.
const STEPS: usize = 10_000;
/// The same for the hybrid: a fifth of them for the physics, the others for what test runs have of their own.
const HYBRID_STEPS: usize = 15_000;
/// Least passes over a recording, however large.
const LEAST_EPOCHS: usize = 300;
/// Most passes over a recording, however small.
const MOST_EPOCHS: usize = 3_000;
/// Shortest control period of the stitched architecture, microseconds: it steps one tick at a time, and its
/// history of five has to reach beyond the valve's dead time.
const STITCHED_LEAST_US: u32 = 5_000;

/// Kinds of models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Our state-space model.
    StateSpace,
    /// Our model of many lungs.
    Hybrid,
    /// The stitched networks of the paper's authors.
    Stitched,
}

/// How to fit a recording; whatever is left open follows from it.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// Kind of model [default: hybrid if the recording names R and C, else state-space].
    pub kind: Option<Kind>,
    /// Passes over the recording.
    pub epochs: Option<usize>,
    /// Breaths per gradient step.
    pub batch: Option<usize>,
    /// State-space, hybrid: states.
    pub states: Option<usize>,
    /// State-space, hybrid: hidden units.
    pub hidden: Option<usize>,
    /// State-space, hybrid: blocks of past commands that a step sees.
    pub history: Option<usize>,
    /// Every so-many-th breath of each lung or test run is held out.
    pub hold_out: usize,
    /// Lungs that are held out altogether.
    pub hold_out_lungs: Vec<LungParameters>,
    /// Seed of initial parameters and order.
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
    /// A lung to hold out that is not there.
    #[error("no breath of the lung {lung} (R:C): the recording has {names}")]
    NoSuchLung {
        /// The lung.
        lung: LungParameters,
        /// Those that are.
        names: String,
    },
    /// Nothing to fit, or nothing to hold out.
    #[error(
        "{breaths} complete inspirations are too few to fit and to hold out every {hold_out}th: record more, or lower \
         --hold-out"
    )]
    TooFewBreaths {
        /// Complete inspirations of the lungs to fit.
        breaths: usize,
        /// See [`Recipe::hold_out`].
        hold_out: usize,
    },
    /// Ticks too fast for the stitched architecture.
    #[error(
        "the stitched architecture steps one control tick at a time, and this recording's are {0} us: collect one with \
         --period-us {PAPER_PERIOD_US}, or fit state-space"
    )]
    FastTicks(u32),
    /// A hybrid of unknown lungs.
    #[error("the hybrid needs R and C of every lung, which this recording does not name: fit state-space")]
    UnknownLungs,
    /// Another control period than that of the paper's authors, microseconds.
    #[error(
        "the recording's control period is {0} us, that of paper-30ms {PAPER_PERIOD_US}: collect one with --period-us \
         {PAPER_PERIOD_US}, or leave --preset out"
    )]
    NotPaperPeriod(u32),
    /// A PEEP that the paper's authors do not have, cmH2O.
    #[error("the recording has breaths at PEEP {0} cmH2O, paper-30ms has {PAPER_PEEP}")]
    NotPaperPeep(f32),
    /// A loss that is no number.
    #[error("the fit diverged in epoch {0}: check the recording for jumps, or try another --seed")]
    Diverged(usize),
}

/// Whether a recording was made in the setting of the paper's authors, as far as it tells.
///
/// # Errors
/// What differs.
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

/// Breaths by what they are for.
#[derive(Clone, Debug)]
pub struct Parts<'a> {
    /// To fit.
    pub training: Vec<&'a Episode>,
    /// To judge.
    pub held_out: Vec<&'a Episode>,
    /// Of lungs that are held out altogether.
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
    /// The kind asked for, or the one that makes the most of what the recording says.
    pub fn kind(&self, recording: &Recording) -> Kind {
        self.kind.unwrap_or(if recording.names_lungs() { Kind::Hybrid } else { Kind::StateSpace })
    }

    /// The architecture for a recording.
    ///
    /// # Errors
    /// A kind that the recording does not suit.
    pub fn architecture(&self, recording: &Recording) -> Result<Architecture, RecipeError> {
        let period_us = recording.provenance.period_us;
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

    /// Splits breaths into those to fit and those to judge by.
    ///
    /// # Errors
    /// A lung to hold out that is not there, or too few breaths.
    pub fn parts<'a>(&self, all: &'a [Episode]) -> Result<Parts<'a>, RecipeError> {
        for lung in &self.hold_out_lungs {
            if !all.iter().any(|episode| episode.lung == Some(*lung)) {
                return Err(RecipeError::NoSuchLung { lung: *lung, names: lungs(all) });
            }
        }
        let other_lung = |e: &&Episode| e.lung.is_some_and(|lung| self.hold_out_lungs.contains(&lung));
        // Every breath's place in its group is counted, whether or not its lung is held out.
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

    /// How to fit so many breaths: a small recording takes more passes, since it is gradient steps that count.
    pub fn config(&self, architecture: &Architecture, breaths: usize) -> FitConfig {
        let mut base = match architecture {
            Architecture::Stitched(_) => FitConfig::authors(),
            _ => FitConfig { batch: BATCH, ..FitConfig::default() },
        };
        let hybrid = matches!(architecture, Architecture::Hybrid(_));
        if hybrid {
            base.adam.weight_decay = HYBRID_DECAY;
        }
        let batch = self.batch.unwrap_or(base.batch);
        let steps = if hybrid { HYBRID_STEPS } else { STEPS };
        let epochs = match architecture {
            Architecture::Stitched(_) => base.epochs,
            _ => (steps * batch / breaths.max(1)).clamp(LEAST_EPOCHS, MOST_EPOCHS),
        };
        let epochs = self.epochs.unwrap_or(epochs);
        FitConfig { epochs, batch, seed: seeds::training(self.seed, 0), ..base }
    }

    /// Fits an architecture to the training breaths of a recording; a fit that is stopped gives the simulator as it is.
    ///
    /// # Errors
    /// A fit that diverges.
    pub fn fit(
        &self,
        architecture: Architecture,
        recording: &Recording,
        training: &[&Episode],
        progress: &Progress<'_>,
    ) -> Result<Fitted, RecipeError> {
        let lessons = lessons(&architecture, recording, training);
        let config = self.config(&architecture, lessons.len());
        let mut fit = Fit::new(architecture, &lessons.iter().collect::<Vec<_>>(), config, None);
        let task = progress.task(Stage::Fit, config.epochs);
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

/// What the model is trained on. The hybrid gets whole breaths, since in expiration, too, lung and ventilator show what
/// they are; and each of them twice, once without its group, so that what a group has of its own stays a deviation from
/// a model that is right without it.
fn lessons(architecture: &Architecture, recording: &Recording, training: &[&Episode]) -> Vec<Episode> {
    if !matches!(architecture, Architecture::Hybrid(_)) {
        return training.iter().map(|episode| (*episode).clone()).collect();
    }
    let mut lessons = whole_breaths(recording, architecture.timing());
    lessons.retain(|breath| training.iter().any(|episode| episode.rows == breath.rows));
    let nameless: Vec<_> = lessons.iter().map(|breath| Episode { group: None, ..breath.clone() }).collect();
    lessons.extend(nameless);
    lessons
}

/// The lungs of some breaths.
fn lungs(episodes: &[Episode]) -> String {
    let mut names: Vec<_> = episodes.iter().filter_map(|e| e.lung).map(|lung| lung.to_string()).collect();
    names.sort();
    names.dedup();
    if names.is_empty() { "no R and C at all".to_owned() } else { names.join(", ") }
}

/// Whether a recording names more than one lung.
fn many_lungs(recording: &Recording) -> bool {
    (1..recording.len()).any(|row| recording.lung(row) != recording.lung(0))
}
