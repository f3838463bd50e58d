//! The measurement of a unit: the zero of its sensor, then breaths under a PID that explores, each saved as soon as it is complete.

use serde::{Deserialize, Serialize};
use shared::settings::Settings;

use super::folder::{breath_file, breath_files};
use super::{FarmRun, Worker};
use crate::error::{Result, StudyError};
use data::identity::TestRun;
use data::provenance::Provenance;
use data::recording::{Extra, Recording};
use data::workspace::Workspace;
use plant::bench::BenchConfig;
use progress::Progress;
use shared::calibration::Calibration;
use ventilator::collect::{BreathEnding, Position, RecordedBreath, collect_from};
use ventilator::{PortSource, Source};

/// Breaths of the measurement of the zero; the last one is evaluated.
const ZERO_BREATHS: usize = 2;
/// End of an expiration at no PEEP over which readings are averaged, s. The lung is empty by then.
const ZERO_TIME: f32 = 1.0;
/// File of the zero.
const ZERO: &str = "zero.json";

/// The reading of the sensor at no pressure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Zero {
    /// As the device reported it, cmH2O.
    pub reading: f32,
    /// The calibration by which the device corrected it, if any.
    pub in_force: Option<Calibration>,
}

/// Short breaths with long expirations at no PEEP: with the expiratory valve open, the pressure falls to that of the room.
fn to_the_room() -> Settings {
    Settings {
        pip: 8.0,
        peep: 0.0,
        rate: 4.0,
        inspiratory_time: 0.3,
        fall_time: 0.0,
        expiratory_bias: 0.0,
        trigger_pressure: 0.0,
        trigger_flow: 0.0,
        ..Settings::default()
    }
}

impl FarmRun<'_> {
    /// Measures a unit, or continues a measurement that was stopped.
    pub(super) fn collect(&self, worker: &Worker<'_>, progress: &Progress<'_>) -> Result<()> {
        if self.recalibrate && worker.recording()?.exists() {
            worker.measure_again()?;
        }
        let folder = worker.measurement()?;
        let recording = worker.recording()?;
        if recording.exists() {
            return Ok(());
        }
        let progress = progress.of(worker.unit.name.as_str());
        let recorded = || breath_files(&folder).len() + usize::from(folder.path(ZERO).exists());
        self.persist(worker, &progress, &recorded, |source, session| {
            if !folder.path(ZERO).exists() {
                folder.save_indented(ZERO, &self.zero(worker, source)?)?;
            }
            self.breaths(worker, source, session, &folder, &progress)
        })?;
        if breath_files(&folder).len() < self.config.run.collect.breaths {
            return Err(StudyError::Stopped);
        }
        self.merged(worker, &folder)?.save(&recording)?;
        // The breaths are in the recording now; leftover files are harmless.
        let _ = folder.remove("breaths");
        Ok(())
    }

    /// Measures the reading at no pressure.
    fn zero(&self, worker: &Worker<'_>, source: &mut PortSource) -> Result<Zero> {
        // Readings would lack the zero of an earlier self-test, which nothing reports.
        source.restart()?;
        let in_force = source.calibration()?;
        let settings = to_the_room();
        source.configure(self.config.run.pid(source.period_us())?, None)?;
        source.upcoming(&[settings; ZERO_BREATHS])?;
        let mut readings = Vec::new();
        for _ in 0..ZERO_BREATHS {
            readings.clear();
            source.breath(&settings, &mut |tick| readings.push(tick.sample.pressure))?;
        }
        let last = shared::math::ticks(ZERO_TIME, source.period_us()) as usize;
        let end = &readings[readings.len().saturating_sub(last)..];
        let reading = end.iter().sum::<f32>() / end.len().max(1) as f32;
        tracing::debug!(unit = %worker.unit.name, reading, "zero");
        Ok(Zero { reading, in_force })
    }

    /// Records the breaths that are missing.
    fn breaths(
        &self,
        worker: &Worker<'_>,
        source: &mut PortSource,
        session: u32,
        folder: &Workspace,
        progress: &Progress<'_>,
    ) -> Result<()> {
        let config = self.config.run.collection(self.number(worker));
        let mut aborts = worker.state()?.aborts;
        let mut breaths = breath_files(folder).len();
        let from = Position { breaths, aborts, sessions: session };
        let provenance = Provenance::new(source.period_us(), "farm");
        let mut failed = None;
        let keep = &mut |breath: &RecordedBreath| {
            match breath.ending {
                BreathEnding::Complete => {
                    let mut recording = Recording::new(provenance.clone(), false);
                    breath.rows.iter().for_each(|row| recording.push(*row));
                    recording.save(breath_file(folder, breaths))?;
                    breaths += 1;
                }
                BreathEnding::Fault(_) => {
                    aborts += 1;
                    failed = worker.remember(|state| state.aborts = aborts).err();
                }
                BreathEnding::Source => {}
            }
            Ok(())
        };
        let pid = self.config.run.pid(source.period_us())?;
        collect_from(source, &pid, &config, from, progress, keep)?;
        match failed {
            Some(error) => Err(error),
            None if aborts > config.aborts => {
                // The next run has as many again.
                worker.remember(|state| state.aborts = 0)?;
                Err(StudyError::Aborted(aborts))
            }
            None => Ok(()),
        }
    }

    /// The recording of a unit from the files of its breaths, with the identity of the unit.
    fn merged(&self, worker: &Worker<'_>, folder: &Workspace) -> Result<Recording> {
        let unit = worker.unit;
        let state = worker.state()?;
        let run = format!("measurement-{}", state.measurement);
        let provenance = Provenance {
            seed: self.config.run.seed,
            plant: format!("unit {}", unit.name),
            plant_parameters: unit.bench().map(BenchConfig::to_toml).unwrap_or_default(),
            settings: serde_json::to_value(self.config.run.collection(self.number(worker)))
                .unwrap_or_default(),
            groups: vec![TestRun::new(unit.name.as_str(), &run)],
            notes: [format!("{} in {} sessions", unit.place, state.sessions), unit.note.clone()]
                .into_iter()
                .filter(|note| !note.is_empty())
                .collect(),
            ..Provenance::new(shared::breath::DEFAULT_PERIOD_US, "farm")
        };
        let extras: &[Extra] = match unit.lung {
            Some(_) => &[Extra::Resistance, Extra::Compliance, Extra::Group],
            None => &[Extra::Group],
        };
        let mut whole = Recording::with_extras(provenance, extras);
        for (number, file) in breath_files(folder).iter().enumerate() {
            let breath = Recording::load(file)?;
            for row in (0..breath.len()).filter_map(|row| breath.row(row)) {
                whole.push(data::recording::Row {
                    // A breath that was repeated has a higher number of its own.
                    breath: number as u32,
                    resistance: unit.lung.map(|lung| lung.resistance),
                    compliance: unit.lung.map(|lung| lung.compliance),
                    group: Some(0),
                    ..row
                });
            }
        }
        Ok(whole)
    }
}

/// The zero of a unit's measurement in force; none before it was measured.
pub(super) fn measured_zero(worker: &Worker<'_>) -> Result<Option<Zero>> {
    Ok(worker.measurement()?.load(ZERO)?)
}
