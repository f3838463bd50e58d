//! The simulators of the units, their calibrations, and the units outside the farm's band.

use std::time::{SystemTime, UNIX_EPOCH};

use super::folder::{FIGURES, SIMULATOR};
use super::measure::measured_zero;
use super::{FarmRun, Outside, Simulators, UnitFigures, Worker};
use crate::error::{Result, StudyError};
use data::recording::Recording;
use data::workspace::Workspace;
use learn::pipeline::PipelineError;
use learn::pipeline::commission::Checked;
use learn::simulator::unit::valve_flows;
use progress::Progress;
use shared::calibration::Calibration;

impl FarmRun<'_> {
    /// Fits the simulators that are missing, stores the calibrations on the devices, and returns what is outside the band.
    pub(super) fn fit(
        &self,
        folder: &Workspace,
        workers: &mut [Worker<'_>],
        progress: &Progress<'_>,
    ) -> Result<Vec<Outside>> {
        match self.config.simulators {
            Simulators::Each => self.fit_each(workers, progress)?,
            Simulators::One => self.fit_one(folder, workers, progress)?,
        }
        self.on_all(workers, calibrate);
        let mut calibrated = Vec::new();
        for worker in workers.iter() {
            // The numbers of a simulator that does not describe its unit mean nothing.
            if worker.figures()?.is_none_or(|figures| figures.unfit.is_some()) {
                continue;
            }
            let last = worker.state()?.calibrations.last().copied();
            calibrated.extend(last.map(|calibration| (worker.unit.name.clone(), calibration)));
        }
        Ok(self.farm.band.outside(&calibrated))
    }

    /// Fits a simulator for each unit that has none.
    fn fit_each(&self, workers: &mut [Worker<'_>], progress: &Progress<'_>) -> Result<()> {
        for worker in workers.iter_mut().filter(|worker| worker.problem.is_none()) {
            if worker.state()?.measured || progress.stopped() {
                continue;
            }
            let progress = progress.of(worker.unit.name.as_str());
            let checked =
                corrected(worker).and_then(|recording| Ok(self.config.run.check(&recording, &progress)?));
            self.fitted(worker, checked)?;
        }
        if progress.stopped() { Err(StudyError::Stopped) } else { Ok(()) }
    }

    /// Fits one simulator for all units, if any of them has none.
    fn fit_one(&self, folder: &Workspace, workers: &mut [Worker<'_>], progress: &Progress<'_>) -> Result<()> {
        let mut units: Vec<&mut Worker<'_>> =
            workers.iter_mut().filter(|worker| worker.problem.is_none()).collect();
        let states: Result<Vec<_>, _> = units.iter().map(|worker| worker.state()).collect();
        if states?.iter().all(|state| state.measured) {
            return Ok(());
        }
        let mut recordings = Vec::new();
        for worker in &mut units {
            match corrected(worker)
                .and_then(|recording| Ok(self.config.run.usable(&recording).map(|()| recording)?))
            {
                Ok(recording) => recordings.push(recording),
                Err(error) => worker.problem = Some(error.to_string()),
            }
        }
        units.retain(|worker| worker.problem.is_none());
        if units.is_empty() {
            return Ok(());
        }
        let (whole, checked) = self.config.run.check_jointly(&recordings, progress)?;
        whole.save(&folder.path(SIMULATOR))?;
        for (worker, checked) in units.iter_mut().zip(checked) {
            self.fitted(worker, Ok(checked))?;
        }
        Ok(())
    }

    /// Saves the simulator of a unit. A recording that cannot be fitted puts the unit behind; a simulator that does not describe the
    /// unit is only left out of the training.
    fn fitted(&self, worker: &mut Worker<'_>, checked: Result<Checked>) -> Result<()> {
        let problem = match checked {
            Ok(Checked { simulator, figures }) => {
                simulator.save(&worker.folder.path(SIMULATOR))?;
                let valve_flow = valve_flows(&simulator.parameters);
                let unfit = figures.problem().map(|problem| problem.to_string());
                let told = UnitFigures { figures, valve_flow, unfit: unfit.clone() };
                worker.folder.save_indented(FIGURES, &told)?;
                unfit
            }
            Err(StudyError::Pipeline(PipelineError::Stopped)) => return Err(StudyError::Stopped),
            Err(error) => {
                worker.problem = Some(error.to_string());
                worker.problem.clone()
            }
        };
        if let Some(problem) = problem {
            (self.tell)(&worker.unit.name, &problem);
        }
        Ok(())
    }
}

/// The recording in force, with the readings that the unit's new calibration gives.
fn corrected(worker: &Worker<'_>) -> Result<Recording> {
    let mut recording = Recording::load(worker.recording()?)?;
    let Some(sensor) = sensor(worker)? else { return Ok(recording) };
    recording.pressure.iter_mut().for_each(|reading| *reading = sensor.corrected(*reading));
    Ok(recording)
}

/// Stores the calibration of a unit on its device, and reads it back.
fn calibrate(worker: &Worker<'_>) -> Result<()> {
    let (state, figures) = (worker.state()?, worker.figures()?);
    let (false, Some(figures), Some(sensor)) = (state.measured, figures, sensor(worker)?) else {
        return Ok(());
    };
    let calibration = Calibration {
        sensor_zero: sensor.zero,
        sensor_gain: sensor.gain,
        dead_time_ms: figures.figures.unit.dead_time_ms,
        lag_ms: figures.figures.unit.lag_ms,
        valve_flow: figures.valve_flow,
        measured_at: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs() as u32),
    };
    calibration.validate().map_err(|error| StudyError::Calibration(error.to_string()))?;
    // Remembered first: a farm that is killed before it reads back still knows its unit.
    worker.remember(|state| state.pending.push(calibration))?;
    let mut device = worker.recognised()?;
    device.stop()?;
    device.calibrate(&calibration)?;
    if device.calibration(0)?.1 != Some(calibration) {
        return Err(StudyError::NotStored("calibration"));
    }
    worker.remember(|state| {
        state.calibrations.push(calibration);
        state.pending.clear();
        state.measured = true;
    })?;
    Ok(())
}

/// The sensor of a unit as just measured; none before that.
fn sensor(worker: &Worker<'_>) -> Result<Option<Sensor>> {
    let zero = measured_zero(worker)?;
    Ok(zero.map(|zero| {
        let before = zero.in_force.map_or((0.0, 1.0), |before| (before.sensor_zero, before.sensor_gain));
        let gain = worker.unit.sensor_gain.unwrap_or(before.1);
        Sensor { before, zero: zero.reading * before.1 + before.0, gain }
    }))
}

/// A sensor as just measured.
#[derive(Clone, Copy, Debug)]
struct Sensor {
    /// Zero and gain by which the device corrected its readings meanwhile.
    before: (f32, f32),
    /// Reading at no pressure, without any correction, cmH2O.
    zero: f32,
    /// Change of the reading per change of the pressure.
    gain: f32,
}

impl Sensor {
    /// A reading of the measurement, corrected again.
    fn corrected(&self, reading: f32) -> f32 {
        let raw = reading * self.before.1 + self.before.0;
        (raw - self.zero) / self.gain
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reading_that_was_corrected_before_is_corrected_from_the_raw_one() {
        // Raw readings are 0.5 + 1.02 p; the device took them for 0.2 + 1.0 p.
        let sensor = Sensor { before: (0.2, 1.0), zero: 0.5, gain: 1.02 };
        for pressure in [0.0, 5.0, 35.0_f32] {
            let reported = 0.5 + 1.02 * pressure - 0.2;
            assert!((sensor.corrected(reported) - pressure).abs() < 1e-5);
        }
    }
}
