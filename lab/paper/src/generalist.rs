//! One controller for all lungs (the paper's robustness experiment), trained on the simulators of all lungs.

use serde::{Deserialize, Serialize};
use shared::control::Controller;

use super::study::Study;
use super::{Reproduction, lungs};
use learn::pipeline::PipelineConfig;
use score::evaluate::Evaluation;
use study::Result;

/// Folder of the controller.
const FOLDER: &str = "generalist";

/// Scores of the controller for all lungs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Generalist {
    pub(super) lungs: Vec<Evaluation>,
    /// Recorded control ticks, summed over all lungs.
    pub(super) ticks: usize,
}

/// Trains and scores the controller.
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

/// The controller, trained first if the folder does not contain it.
pub(super) fn controller(study: &Study<'_>) -> Result<Controller> {
    generalist(study)?;
    study.learned(FOLDER)
}

/// The controller for all lungs, and the best single PID.
pub(super) fn with_rival(study: &Study<'_>) -> Result<(Controller, Controller)> {
    let single = study.pid(lungs::tuned(study)?.over_all.pid.gains)?;
    Ok((controller(study)?, single))
}
