//! The controllers of a farm: one for all units, and from it one for each.

use std::path::Path;

use serde::{Deserialize, Serialize};
use shared::checksum::crc32;
use shared::control::residual::Residual;

use super::folder::{FarmFolder, load, remove, save};
use super::{FarmError, FarmRun, UnitName, Worker};
use learn::controller::learned::Learned;
use learn::pipeline::Folder;
use learn::pipeline::commission::CommissionRun;
use learn::simulator::model::Simulator;
use progress::Progress;

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
        folder: &FarmFolder,
        workers: &[Worker<'_>],
        progress: &Progress<'_>,
    ) -> Result<Controllers, FarmError> {
        let mut units = Vec::new();
        for worker in workers.iter().filter(|worker| worker.problem.is_none()) {
            if worker.folder.figures()?.is_some_and(|figures| figures.unfit.is_none()) {
                units.push(worker);
            }
        }
        let simulators: Result<Vec<_>, _> =
            units.iter().map(|worker| Simulator::load(&worker.folder.simulator())).collect();
        let simulators = simulators?;
        if simulators.is_empty() {
            return Err(FarmError::NoUnit);
        }
        let mut run = self.config.run.clone();
        run.train.iterations = self.config.farm_iterations;
        let all: Vec<&Simulator> = simulators.iter().collect();
        let farm = trained(
            &run,
            &folder.controller(),
            &folder.training(),
            self.start.1,
            &all,
            &progress.of("farm"),
        )?;
        let mut each = Vec::new();
        for (worker, simulator) in units.iter().zip(&simulators) {
            let (name, folder) = (&worker.unit.name, &worker.folder);
            let progress = progress.of(name.as_str());
            let start = &farm.controller;
            let own = trained(
                &self.config.run,
                &folder.controller(),
                &folder.training(),
                start,
                &[simulator],
                &progress,
            )?;
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

/// The controller in a file or, if there is none that was trained from the same, one trained on these simulators.
fn trained(
    run: &CommissionRun,
    file: &Path,
    folder: &Folder,
    start: &Residual,
    simulators: &[&Simulator],
    progress: &Progress<'_>,
) -> Result<Learned, FarmError> {
    let weights: Vec<f32> = start.network().parameters().copied().collect();
    let simulated = simulators.iter().map(|simulator| checksum(&simulator.parameters));
    let origin = Origin { start: checksum(&weights), simulators: simulated.collect() };
    let origin_file = file.with_extension("origin.json");
    if load(&origin_file)?.as_ref() != Some(&origin) {
        remove(file)?;
        remove(&folder.whole(""))?;
        save(&origin_file, &origin)?;
    }
    if file.exists() {
        return Ok(Learned::load(file)?);
    }
    let tuned = run.tune(start, simulators, Some(folder), progress)?;
    if !tuned.complete {
        return Err(FarmError::Stopped);
    }
    tuned.learned.save(file)?;
    Ok(tuned.learned)
}

fn checksum(numbers: &[f32]) -> u32 {
    crc32(&numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>())
}
