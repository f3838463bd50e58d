//! Recording from the page: a Parquet recording of a device and the same as MCAP, and captures that an event triggers, with the time
//! before it. A failure ends the recording with its reason; nothing else is affected.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use data::export::ExportError;
use data::provenance::Provenance;
use data::recording::{DatasetError, EXPIRATION, FALL, INSPIRATION, RecordingWriter, Row};
use serde_json::Value;
use shared::breath::Phase;
use shared::link::messages::DeviceIdentity;
use shared::settings::Settings;
use shared::ventilator::Sample;
use show::monitor::News;
use show::monitor::capture::Capture;
use thiserror::Error;

use crate::stream::{BreathFigures, RecordingInfo, Triggers};

/// Time before the trigger that a capture contains, and time after it, s.
const AROUND_S: (f64, f64) = (10.0, 10.0);

/// Why a recording is not written.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The Parquet file.
    #[error(transparent)]
    Parquet(#[from] DatasetError),
    /// The MCAP file.
    #[error(transparent)]
    Mcap(#[from] ExportError),
}

/// A file that is being written.
struct Tape {
    path: PathBuf,
    /// The page that has started it, in words.
    by: String,
    writer: RecordingWriter,
    samples: u64,
    /// Samples with a value that is no number, and those from before the device reported its settings.
    left_out: u64,
    unset: u64,
}

impl Tape {
    fn create(path: PathBuf, by: &str, provenance: Provenance) -> Result<Self, RecordError> {
        let writer = RecordingWriter::create(&path, provenance, &[])?;
        Ok(Self { path, by: by.to_owned(), writer, samples: 0, left_out: 0, unset: 0 })
    }

    fn push(&mut self, row: Row) -> Result<(), RecordError> {
        self.samples += 1;
        Ok(self.writer.push(row)?)
    }

    /// Finishes the file, with a note of what is not in it.
    fn finish(mut self) -> Result<(), RecordError> {
        let notes = &mut self.writer.provenance().notes;
        if self.left_out > 0 {
            notes.push(format!("left out: {} samples with a value that is no number", self.left_out));
        }
        if self.unset > 0 {
            notes.push(format!("left out: {} samples before the device reported its settings", self.unset));
        }
        Ok(self.writer.finish()?)
    }
}

/// A capture that runs: its file, and the ticks that are still to come.
struct Running {
    tape: Tape,
    left: u64,
}

/// Something to tell the pages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Told(pub String);

/// Records one device.
pub struct Recorder {
    folder: PathBuf,
    device: u8,
    name: String,
    period_us: u32,
    /// The last rows, as long as a capture looks back.
    before: VecDeque<Row>,
    numbers: Numbers,
    tape: Option<Tape>,
    mcap: Option<Capture>,
    triggers: Triggers,
    running: Option<Running>,
}

impl Recorder {
    /// Records into a folder; nothing yet.
    pub fn new(folder: &Path, device: u8, name: &str, period_us: u32) -> Self {
        Self {
            folder: folder.to_owned(),
            device,
            name: name.to_owned(),
            period_us,
            before: VecDeque::new(),
            numbers: Numbers::default(),
            tape: None,
            mcap: None,
            triggers: Triggers::default(),
            running: None,
        }
    }

    /// The recording that is being written.
    pub fn info(&self) -> Option<RecordingInfo> {
        let file = |tape: &Tape| {
            let Tape { path, samples, by, .. } = tape;
            RecordingInfo { file: path.display().to_string(), samples: *samples, by: by.clone() }
        };
        self.tape.as_ref().map(file)
    }

    /// The armed triggers.
    pub fn triggers(&self) -> Option<Triggers> {
        self.triggers.is_armed().then_some(self.triggers)
    }

    /// Another device is there, with this control period, microseconds: a file cannot hold both.
    pub fn set_period(&mut self, period_us: u32) {
        if let Err(error) = self.stop() {
            tracing::error!(%error, "a recording could not be finished");
        }
        self.before.clear();
        self.period_us = period_us;
    }

    /// Starts a recording, at a time in ms since 1970, of a device with this identity, if it is known; returns the file. One that
    /// runs goes on.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn start(
        &mut self,
        now_ms: u64,
        identity: Option<&DeviceIdentity>,
        by: &str,
    ) -> Result<PathBuf, RecordError> {
        if let Some(tape) = &self.tape {
            return Ok(tape.path.clone());
        }
        let path = self.path("recording", now_ms);
        let tape = Tape::create(path.clone(), by, self.provenance(identity))?;
        let mcap = identity.map(|identity| {
            Capture::create(&path.with_extension("mcap"), &self.name, identity, now_ms * 1_000_000)
        });
        match mcap.transpose() {
            Ok(mcap) => {
                (self.tape, self.mcap) = (Some(tape), mcap);
                Ok(path)
            }
            Err(error) => {
                // Half a recording would look like a whole one.
                drop(tape);
                let _ = std::fs::remove_file(&path);
                Err(error.into())
            }
        }
    }

    /// Whether the recording that runs has an MCAP file.
    pub fn has_mcap(&self) -> bool {
        self.mcap.is_some()
    }

    /// Ends the recording; returns the file and its number of samples, if one was running. Finishes both files, whatever happens
    /// to one of them.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn stop(&mut self) -> Result<Option<RecordingInfo>, RecordError> {
        let info = self.info();
        let (tape, mcap) = (self.tape.take(), self.mcap.take());
        let tape = tape.map_or(Ok(()), Tape::finish);
        let mcap = mcap.map_or(Ok(()), |mcap| mcap.finish().map(drop).map_err(RecordError::from));
        tape.and(mcap).map(|()| info)
    }

    /// Arms the triggered capture, or disarms it.
    pub fn arm(&mut self, triggers: Triggers) {
        self.triggers = triggers;
    }

    /// A page has marked the moment; tells the reason if the MCAP file ends with it.
    pub fn mark(&mut self, text: &str, now_ms: u64) -> Option<Told> {
        let tape = self.tape.as_mut()?;
        let place = self
            .before
            .back()
            .map_or_else(String::new, |row| format!(" after breath {} tick {}", row.breath, row.tick));
        tape.writer.provenance().notes.push(format!("marker{place}: {text}"));
        let failed = self.mcap.as_mut().is_some_and(|mcap| mcap.mark(text, now_ms * 1_000_000));
        failed.then(|| self.end_mcap()).flatten()
    }

    /// Takes a piece of news for the MCAP file; tells the reason if it ends there.
    pub fn news(&mut self, news: &News, now_ms: u64) -> Option<Told> {
        let failed = self.mcap.as_mut().is_some_and(|mcap| mcap.take(news, now_ms * 1_000_000));
        failed.then(|| self.end_mcap()).flatten()
    }

    /// Gives up the MCAP file; tells its first failure.
    fn end_mcap(&mut self) -> Option<Told> {
        let reason = self.mcap.take()?.finish().err()?;
        Some(Told(format!("the MCAP file ends here: {reason}")))
    }

    /// Takes a sample, with the settings in force. A recording has them in each row: a sample without them is left out.
    pub fn sample(&mut self, sample: &Sample, settings: Option<&Settings>, now_ms: u64) -> Vec<Told> {
        let running = self.running.as_mut().map(|running| &mut running.tape);
        let tapes = self.tape.iter_mut().chain(running);
        let Some(settings) = settings else {
            tapes.for_each(|tape| tape.unset += 1);
            return Vec::new();
        };
        let Some(row) = self.numbers.row(sample, settings) else {
            tapes.for_each(|tape| tape.left_out += 1);
            return Vec::new();
        };
        self.before.push_back(row);
        if self.before.len() > self.ticks(AROUND_S.0) {
            self.before.pop_front();
        }
        let mut told = Vec::new();
        if let Some(tape) = &mut self.tape
            && let Err(error) = tape.push(row)
        {
            self.tape = None;
            told.push(Told(format!("the recording ends here: {error}")));
        }
        told.extend(self.go_on(row));
        if self.triggers.pressure.is_some_and(|limit| row.pressure > limit) {
            told.extend(self.trigger("pressure above the threshold", now_ms));
        }
        told
    }

    /// An alarm has begun.
    pub fn alarm(&mut self, text: &str, now_ms: u64) -> Option<Told> {
        self.triggers.alarm.then(|| self.trigger(text, now_ms)).flatten()
    }

    /// A breath has ended.
    pub fn breath(&mut self, figures: &BreathFigures, now_ms: u64) -> Option<Told> {
        let exceeds =
            self.triggers.overshoot.zip(figures.overshoot).is_some_and(|(limit, found)| found > limit);
        exceeds.then(|| self.trigger("overshoot above the threshold", now_ms)).flatten()
    }

    /// Starts a capture with the rows before, unless one runs.
    fn trigger(&mut self, why: &str, now_ms: u64) -> Option<Told> {
        if self.running.is_some() {
            return None;
        }
        let mut provenance = self.provenance(None);
        provenance.notes.push(format!("triggered capture: {why}"));
        // One shot: on a sick lung each capture would be followed by the next one, until the disk is full.
        self.triggers = Triggers::default();
        let started = Tape::create(self.path("capture", now_ms), "", provenance).and_then(|mut tape| {
            self.before.iter().try_for_each(|row| tape.push(*row))?;
            Ok(tape)
        });
        match started {
            Ok(tape) => {
                self.running = Some(Running { tape, left: self.ticks(AROUND_S.1) as u64 });
                None
            }
            Err(error) => Some(Told(format!("a capture ({why}) could not be written: {error}"))),
        }
    }

    /// Adds a row to the capture that runs, and finishes it when it is long enough.
    fn go_on(&mut self, row: Row) -> Option<Told> {
        let mut running = self.running.take()?;
        if let Err(error) = running.tape.push(row) {
            return Some(Told(format!("a capture could not be written: {error}")));
        }
        running.left -= 1;
        if running.left > 0 {
            self.running = Some(running);
            return None;
        }
        let path = running.tape.path.display().to_string();
        Some(Told(match running.tape.finish() {
            Ok(()) => format!("capture written to {path}; the triggers are disarmed"),
            Err(error) => format!("a capture could not be written: {error}"),
        }))
    }

    fn ticks(&self, seconds: f64) -> usize {
        (seconds * 1e6 / f64::from(self.period_us.max(1))) as usize
    }

    fn path(&self, what: &str, now_ms: u64) -> PathBuf {
        self.folder.join(format!("{what}-{}-{now_ms}.parquet", self.device))
    }

    fn provenance(&self, identity: Option<&DeviceIdentity>) -> Provenance {
        let mut provenance = Provenance::new(self.period_us, format!("trainer serve: {}", self.name));
        let weights = identity.and_then(DeviceIdentity::running_id);
        provenance.weights_id = weights.map_or_else(String::new, |id| format!("{id:08x}"));
        provenance.settings = Value::Null;
        provenance
    }
}

impl Drop for Recorder {
    /// Finishes what is being written.
    fn drop(&mut self) {
        if let Err(error) = self.stop() {
            tracing::error!(%error, "a recording could not be finished");
        }
        if let Some(Running { tape, .. }) = self.running.take()
            && let Err(error) = tape.finish()
        {
            tracing::error!(%error, "a capture could not be finished");
        }
    }
}

/// Numbers the breaths so that they ascend, also when a ventilation starts again.
#[derive(Debug, Default)]
struct Numbers {
    offset: u32,
    last: Option<(u32, u32)>,
}

impl Numbers {
    /// The row of a sample; none for one that a recording cannot hold.
    fn row(&mut self, sample: &Sample, settings: &Settings) -> Option<Row> {
        let Sample { breath, tick, phase, target, pressure, u_in, u_out, explore, .. } = *sample;
        if ![target, pressure, u_in, explore].iter().all(|value| value.is_finite()) {
            return None;
        }
        let number = |offset: u32| breath.saturating_add(offset);
        if self.last.is_some_and(|last| (number(self.offset), tick) <= last) {
            self.offset = self.last.map_or(0, |(last, _)| last + 1).saturating_sub(breath);
        }
        let breath = number(self.offset);
        self.last = Some((breath, tick));
        let phase = match phase {
            Phase::Inspiration => INSPIRATION,
            Phase::Fall => FALL,
            Phase::Expiration => EXPIRATION,
        };
        let u_out = if u_out { 100.0 } else { 0.0 };
        let (pip, peep) = (settings.pip, settings.peep);
        Some(Row { breath, tick, phase, target, pressure, u_in, u_out, explore, pip, peep, ..Row::default() })
    }
}

#[cfg(test)]
mod tests;
