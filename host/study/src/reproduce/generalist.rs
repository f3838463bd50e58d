//! One controller for all lungs (the paper's robustness): learned over the simulators of all of them.

use serde::{Deserialize, Serialize};
use shared::control::Controller;

use super::study::Study;
use super::{Reproduction, lungs};
use crate::StudyError;
use judge::evaluate::Evaluation;
use learn::controller::learned::Learned;
use learn::pipeline::PipelineConfig;

/// Its folder.
const FOLDER: &str = "generalist";

/// What the controller for all lungs does.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Generalist {
    /// By lung.
    pub(super) lungs: Vec<Evaluation>,
    /// Control ticks recorded, all lungs together.
    pub(super) ticks: usize,
}

/// Trains and scores it.
pub(super) fn generalist(study: &Study<'_>) -> Result<Generalist, StudyError> {
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

/// What the folder holds.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Generalist>, StudyError> {
    study.kept(FOLDER)
}

/// The controller itself, trained if it is not there.
pub(super) fn controller(study: &Study<'_>) -> Result<Controller, StudyError> {
    generalist(study)?;
    let file = study.path(FOLDER).join("controller.safetensors");
    Ok(Controller::Residual(Learned::load(&file)?.controller))
}
