//! Import of the measured tables of the `RespiraWorks` ventilator (100 Hz, blower, test lung) into one recording.
//!
//! The data were taken in closed loop: where neither valve saturates, the exhale command is a linear function of the
//! inhale command, so the two cannot be told apart by a fit. Flows drift; resistors are parabolic, so the column of
//! resistances holds their nominal values. One run drives an oxygen valve in place of the blower's.

mod measured;
mod summary;
mod table;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use serde_json::json;

pub use self::measured::measured;
use self::summary::Observer;
pub use self::summary::{Dropped, ImportSummary};
use self::table::{Sample, Table};
use super::rises::{Rises, is_up};
use crate::provenance::Provenance;
use crate::recording::{DatasetError, EXPIRATION, Extra, FALL, INSPIRATION, Recording, Row};

/// Length of the inspiratory phase from the rise of the set-point, seconds.
///
/// The set-point climbs for 0.1 s and stays up until 1.0 s. The last 0.1 s is left to [`FALL`], so that no inspiratory
/// row sees the exhale valve open for the next phase.
pub const INSPIRATION_S: f64 = 0.9;

/// Optional columns of an imported recording.
const EXTRAS: [Extra; 6] =
    [Extra::FlowIn, Extra::FlowOut, Extra::Resistance, Extra::Compliance, Extra::UPsol, Extra::Group];

/// Reads tables into one recording, in the order given, with one group per run and test (`CT_AIR:3`).
///
/// A breath starts where the set-point rises after a rest and ends at the next one, at a change of run or test, or at a
/// gap in time. Rows that belong to no breath are dropped and counted.
///
/// # Errors
/// If a table cannot be read, lacks a column, has a cell that is no usable number (with line and column), is sampled at
/// another rate than the one before, or if there is no breath at all.
pub fn import(paths: &[PathBuf]) -> Result<(Recording, ImportSummary), DatasetError> {
    let mut importer = Importer::new(paths);
    for path in paths {
        let mut table = Table::open(path)?;
        while let Some((name, samples)) = table.next_test()? {
            importer.add_test(path, name, &samples)?;
        }
    }
    if importer.breaths == 0 {
        return Err(DatasetError::NoBreath { tables: paths.len() });
    }
    importer.recording.validate()?;
    let summary = importer.observer.finish(&importer.recording, importer.breaths);
    Ok((importer.recording, summary))
}

struct Importer {
    recording: Recording,
    observer: Observer,
    breaths: u32,
    /// Control period of the first test; later ones must have the same.
    period_us: Option<u32>,
}

impl Importer {
    fn new(paths: &[PathBuf]) -> Self {
        let files: Vec<_> =
            paths.iter().filter_map(|path| path.file_name()).map(|name| name.to_string_lossy()).collect();
        let provenance = Provenance {
            plant: "respiraworks".to_owned(),
            settings: json!({ "files": files, "inspiration_s": INSPIRATION_S }),
            notes: vec![
                "measured in closed loop; resistances are nominal, the resistors are parabolic".to_owned(),
            ],
            ..Provenance::new(0, "import of RespiraWorks tables")
        };
        Self {
            recording: Recording::with_extras(provenance, &EXTRAS),
            observer: Observer::default(),
            breaths: 0,
            period_us: None,
        }
    }

    fn add_test(&mut self, path: &Path, name: String, samples: &[Sample]) -> Result<(), DatasetError> {
        let found_us = period_us(samples).or(self.period_us).unwrap_or(0);
        let expected_us = *self.period_us.get_or_insert(found_us);
        if found_us != expected_us {
            return Err(DatasetError::Period { path: path.to_owned(), test: name, found_us, expected_us });
        }
        self.recording.provenance.period_us = expected_us;
        self.observer.test(&name, samples);
        let group = self.recording.provenance.groups.len() as u32;
        self.recording.provenance.groups.push(name);

        let period_s = f64::from(expected_us) * 1e-6;
        let follows = |a: &Sample, b: &Sample| (b.time_s - a.time_s - period_s).abs() <= 0.5 * period_s;
        for (part, segment) in samples.chunk_by(follows).enumerate() {
            self.add_segment(group, period_s, segment, part > 0);
        }
        Ok(())
    }

    /// Adds the breaths of rows without a gap.
    fn add_segment(&mut self, group: u32, period_s: f64, segment: &[Sample], after_gap: bool) {
        let mut rises = Rises::new(period_s);
        let starts: Vec<usize> =
            (0..segment.len()).filter(|row| rises.starts(segment[*row].setpoint)).collect();
        self.observer.segment(segment, starts.first().copied().unwrap_or(segment.len()), after_gap);
        for (index, &start) in starts.iter().enumerate() {
            let end = starts.get(index + 1).copied().unwrap_or(segment.len());
            self.add_breath(group, period_s, segment[start - 1].setpoint, &segment[start..end]);
        }
    }

    fn add_breath(&mut self, group: u32, period_s: f64, setpoint_before: f32, samples: &[Sample]) {
        let inspiration = (INSPIRATION_S / period_s).round() as usize;
        let peep = setting(setpoint_before);
        let pip = setting(samples.iter().map(|sample| sample.setpoint).fold(setpoint_before, f32::max));
        for (tick, sample) in samples.iter().enumerate() {
            let phase = match tick {
                tick if tick < inspiration => INSPIRATION,
                _ if is_up(sample.setpoint, peep) => FALL,
                _ => EXPIRATION,
            };
            self.recording.push(Row {
                breath: self.breaths,
                tick: tick as u32,
                phase,
                pip,
                peep,
                ..row(sample, group)
            });
        }
        self.breaths += 1;
    }
}

/// What a sample says by itself.
fn row(sample: &Sample, group: u32) -> Row {
    Row {
        target: sample.setpoint,
        pressure: sample.pressure,
        u_in: sample.inhale,
        u_out: sample.exhale,
        u_psol: Some(sample.psol),
        flow_in: Some(sample.flow_in),
        flow_out: Some(sample.flow_out),
        resistance: Some(sample.resistance),
        compliance: Some(sample.compliance),
        group: Some(group),
        ..Row::default()
    }
}

/// A pressure setting, cmH2O: the set-point without the rounding noise of its transmission (0.001).
fn setting(setpoint: f32) -> f32 {
    (setpoint * 100.0).round() / 100.0
}

/// Median distance in time, so that gaps do not count; `None` for a single row.
fn period_us(samples: &[Sample]) -> Option<u32> {
    let mut steps: Vec<f64> = samples.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).collect();
    steps.sort_by(f64::total_cmp);
    let median = *steps.get(steps.len() / 2)?;
    (median > 0.0).then(|| (median * 1e6).round() as u32)
}
