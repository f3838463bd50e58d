//! The controllers of a farm: one for all units, and from it one for each.

use serde::{Deserialize, Serialize};
use shared::control::residual::Residual;

use super::folder::SIMULATOR;
use super::{FarmRun, UnitName, Worker};
use crate::error::{Result, StudyError};
use data::workspace::Workspace;
use learn::controller::learned::Learned;
use learn::pipeline::checksum;
use learn::pipeline::commission::CommissionRun;
use learn::simulator::model::Simulator;
use progress::Progress;

/// File of a controller.
const CONTROLLER: &str = "controller.safetensors";
/// File of what it was trained from.
const ORIGIN: &str = "controller.origin.json";
/// Folder of the training's checkpoints.
const TRAINING: &str = "training";

/// The learned controllers.
pub(super) struct Controllers {
    /// For all units.
    pub farm: Learned,
    /// For each unit whose simulator describes it.
    pub each: Vec<(UnitName, Learned)>,
}

impl FarmRun<'_> {
    /// Trains the controllers that are missing.
    pub(super) fn train(
        &self,
        folder: &Workspace,
        workers: &[Worker<'_>],
        progress: &Progress<'_>,
    ) -> Result<Controllers> {
        let mut units = Vec::new();
        for worker in workers.iter().filter(|worker| worker.problem.is_none()) {
            if worker.figures()?.is_some_and(|figures| figures.unfit.is_none()) {
                units.push(worker);
            }
        }
        let simulators: Result<Vec<_>, _> =
            units.iter().map(|worker| Simulator::load(&worker.folder.path(SIMULATOR))).collect();
        let simulators = simulators?;
        if simulators.is_empty() {
            return Err(StudyError::NoUnit);
        }
        let mut run = self.config.run.clone();
        run.train.iterations = self.config.farm_iterations;
        let all: Vec<&Simulator> = simulators.iter().collect();
        let farm = trained(&run, folder, self.start.1, &all, &progress.of("farm"))?;
        let mut each = Vec::new();
        for (worker, simulator) in units.iter().zip(&simulators) {
            let (name, run) = (&worker.unit.name, &self.config.run);
            let progress = progress.of(name.as_str());
            let own = trained(run, &worker.folder, &farm.controller, &[simulator], &progress)?;
            each.push((name.clone(), own));
        }
        Ok(Controllers { farm, each })
    }
}

/// What a controller is trained from. With any other, it is trained again.
#[derive(PartialEq, Serialize, Deserialize)]
struct Origin {
    /// Checksum of the controller that it starts from.
    start: u32,
    /// Checksums of the simulators.
    simulators: Vec<u32>,
}

/// The controller in a folder or, if there is none that was trained from the same, one trained on these simulators.
fn trained(
    run: &CommissionRun,
    folder: &Workspace,
    start: &Residual,
    simulators: &[&Simulator],
    progress: &Progress<'_>,
) -> Result<Learned> {
    let simulated = simulators.iter().map(|simulator| checksum(&simulator.parameters)).collect();
    let origin = Origin { start: checksum(start.network().parameters()), simulators: simulated };
    if folder.load(ORIGIN)?.as_ref() != Some(&origin) {
        [CONTROLLER, TRAINING].iter().try_for_each(|name| folder.remove(name))?;
        folder.save_indented(ORIGIN, &origin)?;
    }
    let file = folder.path(CONTROLLER);
    if file.exists() {
        return Ok(Learned::load(&file)?);
    }
    let tuned = run.tune(start, simulators, Some(&folder.folder(TRAINING)), progress)?;
    if !tuned.complete {
        return Err(StudyError::Stopped);
    }
    tuned.learned.save(&file)?;
    Ok(tuned.learned)
}
