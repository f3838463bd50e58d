//! The authors' own plant: a controller trained only on recordings of it, beside the authors' figures.

use serde::{Deserialize, Serialize};
use serde_json::json;
use shared::control::Controller;
use shared::control::pid::Pid;

use super::study::Study;
use super::{Reproduction, lungs};
use crate::authors::{self, baseline};
use learn::pipeline::{self, RunFolder};
use plant::balloon::PERIOD_US;
use study::Result;
use ventilator::{BalloonSource, Source, SourceError};

/// The authors' scores, cmH2O: the best PI of their grid, their network trained on the plant itself, and their network
/// trained through a learned simulator.
pub(super) const AUTHORS: [f64; 3] = [2.239, 2.013, 3.739];

/// Scores on the balloon, mean over the waveforms, cmH2O.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct OnBalloon {
    /// Full flow, then an exact hold.
    pub(super) floor: f64,
    /// The lowest that any commands reach: the valve does not close fully.
    pub(super) bound: f64,
    pub(super) grid_pi: f64,
    /// Our controllers, trained through simulators learned from recordings, by seed.
    pub(super) learned: Vec<f64>,
}

/// Trains on recordings of the balloon and scores on it.
pub(super) fn balloon(study: &Study<'_>) -> Result<OnBalloon> {
    study.keep("balloon", || {
        let Reproduction { seed, budget, .. } = study.reproduction;
        let mut learned = Vec::new();
        for repeat in 0..budget.repeats {
            // Always in full: with a smaller budget it does not reach the grid's PI.
            let config = authors::pipeline(seed + repeat);
            let base = Controller::Pid(Pid::new(config.gains, PERIOD_US)?);
            let source = |_| -> Result<Box<dyn Source>, SourceError> {
                Ok(Box::new(BalloonSource::new(base.clone())))
            };
            let outcome = lungs::train_by(study, &format!("balloon-{repeat}"), |run, progress| {
                let folder = RunFolder { workspace: run, plants: vec![json!("balloon")] };
                pipeline::run(&config, &[&source], Some(folder), progress)
            })?;
            learned.push(authors::score(&Controller::Residual(outcome.learned.controller))?);
        }
        Ok(OnBalloon {
            floor: baseline::floor(),
            bound: baseline::bound(),
            grid_pi: baseline::best_pi().score,
            learned,
        })
    })
}
