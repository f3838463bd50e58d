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

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{FarmConfig, FarmError, FarmRun, UnitFigures, UnitName};
use data::files::{claim, read_json, write_json_indented};
use learn::pipeline::Folder;
use plant::bench::BenchConfig;
use shared::calibration::Calibration;

/// File of a unit's figures.
pub(super) const FIGURES: &str = "figures.json";
/// File of a controller.
const CONTROLLER: &str = "controller.safetensors";

/// The folder of a farm.
pub(super) struct FarmFolder(PathBuf);

/// The folder of a unit.
#[derive(Clone, Debug)]
pub(super) struct UnitFolder(PathBuf);

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

impl FarmFolder {
    pub fn new(path: &Path) -> Self {
        Self(path.to_owned())
    }

    /// Claims the folder for this farm.
    pub fn claim(&self, run: &FarmRun<'_>) -> Result<(), FarmError> {
        let place = |unit: &super::Unit| {
            let bench = unit.bench().map(BenchConfig::to_toml);
            (unit.name.clone(), bench.unwrap_or_else(|| unit.place.to_string()))
        };
        let units = run.farm.units.iter().map(place).collect();
        let claimed = Claim { units, start: run.start.0.to_owned(), config: run.config.clone() };
        let own = claim(&self.0, &claimed).map_err(FarmError::file(&self.0))?;
        if own { Ok(()) } else { Err(FarmError::OtherFarm(self.0.clone())) }
    }

    pub fn unit(&self, name: &UnitName) -> UnitFolder {
        UnitFolder(self.0.join("units").join(name.as_str()))
    }

    pub fn controller(&self) -> PathBuf {
        self.0.join(CONTROLLER)
    }

    /// Checkpoints of the training.
    pub fn training(&self) -> Folder {
        Folder::new(self.0.join("training"))
    }

    /// The simulator of all units.
    pub fn simulator(&self) -> PathBuf {
        self.0.join("simulator.safetensors")
    }

    /// Best single PID and bounds.
    pub fn rivals(&self) -> PathBuf {
        self.0.join("rivals.json")
    }
}

impl UnitFolder {
    pub fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    pub fn state(&self) -> Result<UnitState, FarmError> {
        Ok(load(&self.file("unit.json"))?.unwrap_or_default())
    }

    /// Changes what is remembered of the unit.
    pub fn remember(&self, change: impl FnOnce(&mut UnitState)) -> Result<UnitState, FarmError> {
        let mut state = self.state()?;
        change(&mut state);
        save(&self.file("unit.json"), &state)?;
        Ok(state)
    }

    /// Folder of the measurement in force.
    pub fn measurement(&self) -> Result<PathBuf, FarmError> {
        Ok(self.0.join(format!("measurement-{}", self.state()?.measurement)))
    }

    /// The recording in force.
    pub fn recording(&self) -> Result<PathBuf, FarmError> {
        Ok(self.measurement()?.join("recording.parquet"))
    }

    /// Scores of controllers on the unit as last measured.
    pub fn scores(&self) -> Result<PathBuf, FarmError> {
        Ok(self.0.join(format!("crosswise-{}.json", self.state()?.measurement)))
    }

    /// Begins a new measurement.
    pub fn measure_again(&self) -> Result<(), FarmError> {
        self.remember(|state| {
            (state.measurement, state.measured, state.aborts) = (state.measurement + 1, false, 0);
        })?;
        Ok(())
    }

    /// Forgets the device of the unit, which was replaced. Its recordings stay.
    pub fn forget_device(&self) -> Result<(), FarmError> {
        let state = self.state()?;
        let new = UnitState {
            sessions: state.sessions,
            measurement: state.measurement + 1,
            ..UnitState::default()
        };
        self.remember(|state| *state = new)?;
        [self.simulator(), self.file(FIGURES)].iter().try_for_each(|file| remove(file))
    }

    /// Complete breaths of the recording in force.
    pub fn breaths(&self) -> Result<usize, FarmError> {
        let recording = self.recording()?;
        if recording.exists() {
            return Ok(data::recording::Recording::load(recording)?.inspirations().len());
        }
        Ok(breath_files(&self.measurement()?).len())
    }

    pub fn simulator(&self) -> PathBuf {
        self.file("simulator.safetensors")
    }

    pub fn figures(&self) -> Result<Option<UnitFigures>, FarmError> {
        load(&self.file(FIGURES))
    }

    pub fn controller(&self) -> PathBuf {
        self.file(CONTROLLER)
    }

    pub fn training(&self) -> Folder {
        Folder::new(self.file("training"))
    }
}

/// The files of the breaths in a measurement's folder, from the first one on without a gap.
pub(super) fn breath_files(measurement: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    while breath_file(measurement, files.len()).exists() {
        files.push(breath_file(measurement, files.len()));
    }
    files
}

/// The file of a breath.
pub(super) fn breath_file(measurement: &Path, number: usize) -> PathBuf {
    measurement.join("breaths").join(format!("{number:04}.parquet"))
}

/// Removes a file or a folder, if it exists.
pub(super) fn remove(path: &Path) -> Result<(), FarmError> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(FarmError::file(path)(error)),
        _ => Ok(()),
    }
}

/// Reads a file of the folder; none if it does not exist.
pub(super) fn load<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, FarmError> {
    read_json(path).map_err(FarmError::file(path))
}

/// Writes a file of the folder.
pub(super) fn save(path: &Path, value: &impl Serialize) -> Result<(), FarmError> {
    write_json_indented(path, value).map_err(FarmError::file(path))
}
