//! One controller for all lungs (the paper's robustness): learned over the simulators of all of them.

use serde::{Deserialize, Serialize};
use shared::control::Controller;

use super::study::Study;
use super::{Reproduction, lungs};
use crate::error::Result;
use judge::evaluate::Evaluation;
use learn::pipeline::PipelineConfig;

/// Its folder.
const FOLDER: &str = "generalist";

/// What the controller for all lungs does.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Generalist {
    pub(super) lungs: Vec<Evaluation>,
    /// Control ticks recorded, all lungs together.
    pub(super) ticks: usize,
}

/// Trains and scores it.
pub(super) fn generalist(study: &Study<'_>) -> Result<Generalist> {
    study.keep(FOLDER, || {
        let Reproduction { seed, budget, .. } = study.reproduction;
        let gains = lungs::tuned(study)?.over_all.pid.gains;
        let config = PipelineConfig { gains, seed: *seed, ..budget.generalist.clone() };
        let outcome = lungs::train(study, study.lungs(), &config, FOLDER)?;
        let controller = Controller::Residual(outcome.learned.controller);
        let evaluations = study.lungs().iter().map(|bench| study.evaluate(bench, &controller));
        Ok(Generalist {
            lungs: evaluations.collect::<Result<_, _>>()?,
            ticks: outcome.plants.iter().map(|plant| plant.recording.len()).sum(),
        })
    })
}

/// The controller itself, trained if it is not there.
pub(super) fn controller(study: &Study<'_>) -> Result<Controller> {
    generalist(study)?;
    study.learned(FOLDER)
}

/// The same, and the best single PID.
pub(super) fn with_rival(study: &Study<'_>) -> Result<(Controller, Controller)> {
    let single = study.pid(lungs::tuned(study)?.over_all.pid.gains)?;
    Ok((controller(study)?, single))
}
