//! The folder of a farm. Every file is written whole and renamed, so that a farm can be killed at any moment.
//!
//! ```text
//! run.json                           units and configuration; another farm is refused
//! controller.safetensors, training/  the controller for all units, and simulator.safetensors if there is one for all
//! rivals.json                        best single PID and reference bounds
//! units/N/unit.json                  sessions, calibrations, the weights on the unit
//! units/N/measurement-K/             zero.json; breaths/0000.parquet and so on, while they are recorded; recording.parquet
//! units/N/simulator.safetensors, figures.json
//! units/N/controller.safetensors, training/, crosswise-K.json
//! ```

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{FarmConfig, FarmRun, Unit, UnitFigures, UnitName, Worker};
use crate::error::Result;
use data::recording::Recording;
use data::workspace::Workspace;
use plant::bench::BenchConfig;
use shared::calibration::Calibration;

/// File of a unit's figures.
pub(super) const FIGURES: &str = "figures.json";
/// File of a simulator.
pub(super) const SIMULATOR: &str = "simulator.safetensors";
/// File of what is remembered of a unit.
const STATE: &str = "unit.json";

/// What is remembered of a unit.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct UnitState {
    /// Connections for a recording so far.
    pub sessions: u32,
    /// Breaths that the pressure limit ended, in the measurement that is under way.
    pub aborts: usize,
    /// The measurement in force, counted from 0.
    pub measurement: u32,
    /// Whether that measurement is complete: recorded, fitted and stored on the device.
    pub measured: bool,
    /// Calibrations that were to be stored on its device and may be there.
    pub pending: Vec<Calibration>,
    /// Calibrations stored on its device, oldest first.
    pub calibrations: Vec<Calibration>,
    /// Weights that run on it, verified.
    pub weights: Option<Flashed>,
}

/// Weights on a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Flashed {
    /// Their id as trained.
    pub trained: String,
    /// Their id on the device, which is that of the signed image if there is a key.
    pub stored: String,
}

/// The settings that must match to continue.
#[derive(PartialEq, Serialize, Deserialize)]
struct Claim {
    units: Vec<(UnitName, String)>,
    /// Name of the controller to start from.
    start: String,
    config: FarmConfig,
}

impl FarmRun<'_> {
    /// Claims the folder for this farm.
    pub(super) fn claim(&self, folder: &Workspace) -> Result<()> {
        let place = |unit: &Unit| {
            let bench = unit.bench().map(BenchConfig::to_toml);
            (unit.name.clone(), bench.unwrap_or_else(|| unit.place.to_string()))
        };
        let units = self.farm.units.iter().map(place).collect();
        Ok(folder.claim(&Claim { units, start: self.start.0.to_owned(), config: self.config.clone() })?)
    }
}

impl Worker<'_> {
    pub fn state(&self) -> Result<UnitState> {
        Ok(self.folder.load(STATE)?.unwrap_or_default())
    }

    /// Changes what is remembered of the unit.
    pub fn remember(&self, change: impl FnOnce(&mut UnitState)) -> Result<UnitState> {
        let mut state = self.state()?;
        change(&mut state);
        self.folder.save_indented(STATE, &state)?;
        Ok(state)
    }

    /// Folder of the measurement in force.
    pub fn measurement(&self) -> Result<Workspace> {
        Ok(self.folder.folder(&format!("measurement-{}", self.state()?.measurement)))
    }

    /// The recording in force.
    pub fn recording(&self) -> Result<PathBuf> {
        Ok(self.measurement()?.path("recording.parquet"))
    }

    /// File of the scores of controllers on the unit as last measured.
    pub fn scores(&self) -> Result<String> {
        Ok(format!("crosswise-{}.json", self.state()?.measurement))
    }

    /// Begins a new measurement.
    pub fn measure_again(&self) -> Result<()> {
        self.remember(|state| {
            (state.measurement, state.measured, state.aborts) = (state.measurement + 1, false, 0);
        })?;
        Ok(())
    }

    /// Forgets the device of the unit, which was replaced. Its recordings stay.
    pub fn forget_device(&self) -> Result<()> {
        let state = self.state()?;
        let new = UnitState {
            sessions: state.sessions,
            measurement: state.measurement + 1,
            ..UnitState::default()
        };
        self.remember(|state| *state = new)?;
        [SIMULATOR, FIGURES].iter().try_for_each(|name| Ok(self.folder.remove(name)?))
    }

    /// Complete breaths of the recording in force.
    pub fn breaths(&self) -> Result<usize> {
        let recording = self.recording()?;
        if recording.exists() {
            return Ok(Recording::load(recording)?.inspirations().len());
        }
        Ok(breath_files(&self.measurement()?).len())
    }

    /// What a fit has told of it.
    pub fn figures(&self) -> Result<Option<UnitFigures>> {
        Ok(self.folder.load(FIGURES)?)
    }
}

/// The files of the breaths in a measurement's folder, from the first one on without a gap.
pub(super) fn breath_files(measurement: &Workspace) -> Vec<PathBuf> {
    let mut files = Vec::new();
    while breath_file(measurement, files.len()).exists() {
        files.push(breath_file(measurement, files.len()));
    }
    files
}

/// The file of a breath.
pub(super) fn breath_file(measurement: &Workspace, number: usize) -> PathBuf {
    measurement.path(&format!("breaths/{number:04}.parquet"))
}
