//! Recording from the page: a Parquet recording of a device and the same as MCAP, and captures that an event triggers, with the time
//! before it. A failure ends the recording with its reason; nothing else is affected.
//!
//! Here is what goes into which file; a thread of its own writes it (`writer`), so that a slow disk delays nothing. What it
//! has no room for is lost, and counted.

mod numbers;
mod recorded_file;
mod writer;

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use data::provenance::Provenance;
use data::recording::Row;
use serde_json::Value;
use shared::link::messages::{DeviceIdentity, Event};
use shared::link::telemetry::PackedSample;
use shared::settings::Settings;
use shared::ventilator::Sample;
use shared::weights::ImageId;
use show::monitor::News;

use crate::stream::{BreathFigures, RecordingInfo, Triggers};
use numbers::Numbers;
use recorded_file::{Gap, RecordedFile, Stage};
#[cfg(test)]
pub use writer::WAITING_MAX;
use writer::{Job, McapHead, RecordError, Report, Which, Writer};

/// Time before the trigger that a capture contains, and time after it, s.
const AROUND_S: (f64, f64) = (10.0, 10.0);

/// Something for the pages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// Something that happened.
    Event(String),
    /// What has become of the request to record, or why nothing.
    Started(Result<String, String>),
    /// What has become of the request to end the recording.
    Stopped(Result<String, String>),
}

/// Records one device.
pub struct Recorder {
    folder: PathBuf,
    device: u8,
    name: String,
    period_us: u32,
    writer: Writer,
    /// The last rows, as long as a capture looks back.
    before: VecDeque<Row>,
    numbers: Numbers,
    recording: Option<RecordedFile>,
    /// Whether the recording has an MCAP file.
    mcap: bool,
    triggers: Triggers,
    /// The capture that runs, and the ticks that are still to come.
    capture: Option<RecordedFile>,
    left: u64,
    notices: Vec<Notice>,
}

impl Recorder {
    /// Records into a folder; nothing yet.
    pub fn new(folder: &Path, device: u8, name: &str, period_us: u32) -> Self {
        Self {
            folder: folder.to_owned(),
            device,
            name: name.to_owned(),
            period_us,
            writer: Writer::start(),
            before: VecDeque::new(),
            numbers: Numbers::default(),
            recording: None,
            mcap: false,
            triggers: Triggers::default(),
            capture: None,
            left: 0,
            notices: Vec::new(),
        }
    }

    /// Makes the writer hang, like a disk, until what is returned is dropped. It has done all earlier jobs.
    #[cfg(test)]
    pub fn hang(&self) -> std::sync::mpsc::SyncSender<()> {
        let (goes_on, until) = std::sync::mpsc::sync_channel(0);
        self.writer.give(Job::Pause(until));
        // Without a buffer, this waits until the writer receives.
        goes_on.send(()).unwrap();
        goes_on
    }

    /// The recording that takes samples.
    pub fn info(&self) -> Option<RecordingInfo> {
        let RecordedFile { path, samples, lost, by, .. } =
            self.recording.as_ref().filter(|file| file.takes())?;
        let file = path.display().to_string();
        Some(RecordingInfo { file, samples: *samples, lost: *lost, by: by.clone() })
    }

    /// The armed triggers.
    pub fn triggers(&self) -> Option<Triggers> {
        self.triggers.is_armed().then_some(self.triggers)
    }

    /// Another device is there, with this control period, microseconds: a file cannot hold both.
    pub fn set_period(&mut self, period_us: u32) {
        self.close(Which::Recording);
        self.close(Which::Capture);
        self.before.clear();
        self.period_us = period_us;
    }

    /// Starts a recording, at a time in ms since 1970, of a device with this identity, if it is known. One that runs goes on.
    /// [`Notice::Started`] follows.
    ///
    /// # Errors
    /// The last one is not finished.
    pub fn start(
        &mut self,
        now_ms: u64,
        identity: Option<&DeviceIdentity>,
        by: &str,
    ) -> Result<(), &'static str> {
        match self.recording.as_ref().map(|file| file.stage) {
            Some(Stage::Opening) => return Ok(()),
            Some(Stage::Open) => {
                self.notices.push(self.started());
                return Ok(());
            }
            Some(Stage::Closing) => return Err("the last recording is still being written: try again soon"),
            None => {}
        }
        let path = self.path("recording", now_ms);
        self.mcap = identity.is_some();
        let mcap = identity.map(|identity| {
            Box::new(McapHead { name: self.name.clone(), identity: identity.clone(), now_ms })
        });
        let provenance = Box::new(self.provenance(identity));
        self.writer.give(Job::Open { which: Which::Recording, path: path.clone(), provenance, mcap });
        self.recording = Some(RecordedFile::new(path, by));
        Ok(())
    }

    fn started(&self) -> Notice {
        let path = self.recording.as_ref().map_or_else(String::new, |file| file.path.display().to_string());
        let alone = if self.mcap { "" } else { ", without MCAP: the device is not known" };
        Notice::Started(Ok(format!("recording to {path}{alone}")))
    }

    /// Ends the recording; [`Notice::Stopped`] follows, if one was running.
    pub fn stop(&mut self) -> bool {
        self.close(Which::Recording);
        self.recording.is_some()
    }

    /// Finishes a file.
    fn close(&mut self, which: Which) {
        if let Some(file) = self.slot(which).as_mut().filter(|file| file.takes()) {
            file.stage = Stage::Closing;
            let notes = file.gaps();
            self.writer.give(Job::Close { which, notes });
        }
    }

    /// Arms the triggered capture, or disarms it.
    pub fn arm(&mut self, triggers: Triggers) {
        self.triggers = triggers;
    }

    /// A page has marked the moment; false if the recording that runs lacks the marker.
    pub fn mark(&mut self, text: &str, now_ms: u64) -> bool {
        if self.info().is_none() {
            return true;
        }
        let room = self.writer.has_room();
        if room {
            self.note(text, now_ms);
        }
        room
    }

    /// Notes something in the recording, at the place where it is.
    fn note(&mut self, text: &str, now_ms: u64) {
        let place = self
            .before
            .back()
            .map_or_else(String::new, |row| format!(" after breath {} tick {}", row.breath, row.tick));
        let (note, text) = (format!("marker{place}: {text}"), text.to_owned());
        self.writer.give(Job::Mark { note, text, now_ms });
    }

    /// Takes a piece of news, with the settings in force.
    pub fn take(&mut self, news: &News, settings: Option<&Settings>, now_ms: u64) {
        let room = self.writer.has_room();
        if room && self.mcap && self.info().is_some() {
            self.writer.give(Job::News(Box::new(news.clone()), now_ms));
        }
        if let News::Event(Event::Telemetry(batch)) = news {
            self.samples(batch.samples.iter().map(PackedSample::unpack), settings, room, now_ms);
        }
    }

    /// Takes samples. A recording has the settings in each row: a sample without them is left out.
    fn samples(
        &mut self,
        samples: impl IntoIterator<Item = Sample>,
        settings: Option<&Settings>,
        room: bool,
        now_ms: u64,
    ) {
        let (mut recorded, mut captured) = (Vec::new(), Vec::new());
        for sample in samples {
            let row = settings.ok_or(Gap::Unset).and_then(|settings| self.numbers.row(&sample, settings));
            let row = match row {
                Ok(row) => row,
                Err(gap) => {
                    let files =
                        self.recording.iter_mut().chain(&mut self.capture).filter(|file| file.takes());
                    files.for_each(|file| file.leave_out(gap));
                    continue;
                }
            };
            self.before.push_back(row);
            if self.before.len() > self.ticks(AROUND_S.0) {
                self.before.pop_front();
            }
            recorded.push(row);
            if self.capture.as_ref().is_some_and(RecordedFile::takes) {
                captured.push(row);
                self.left = self.left.saturating_sub(1);
                if self.left == 0 {
                    self.add(Which::Capture, std::mem::take(&mut captured), room, now_ms);
                    self.close(Which::Capture);
                }
            }
            if self.triggers.pressure.is_some_and(|limit| row.pressure > limit) {
                self.trigger("pressure above the threshold", now_ms);
            }
        }
        self.add(Which::Recording, recorded, room, now_ms);
        self.add(Which::Capture, captured, room, now_ms);
    }

    /// Adds rows to a file that takes some, if there is room.
    fn add(&mut self, which: Which, rows: Vec<Row>, room: bool, now_ms: u64) {
        let count = rows.len() as u64;
        let Some(file) = self.slot(which).as_mut().filter(|file| file.takes() && count > 0) else { return };
        if room {
            file.samples += count;
            self.writer.give(Job::Rows { which, rows });
            return;
        }
        let first = file.lost == 0;
        file.lost += count;
        if first {
            let what = match which {
                Which::Recording => "recording",
                Which::Capture => "capture",
            };
            self.notices.push(Notice::Event(format!("the disk is too slow: the {what} loses samples")));
        }
        if first && which == Which::Recording {
            // The only way to report it in the MCAP file.
            self.note("the disk is too slow: samples are lost from here on", now_ms);
        }
    }

    /// An alarm has begun.
    pub fn alarm(&mut self, text: &str, now_ms: u64) {
        if self.triggers.alarm {
            self.trigger(text, now_ms);
        }
    }

    /// A breath has ended.
    pub fn breath(&mut self, figures: &BreathFigures, now_ms: u64) {
        let limit = self.triggers.overshoot.zip(figures.overshoot);
        if limit.is_some_and(|(limit, found)| found > limit) {
            self.trigger("overshoot above the threshold", now_ms);
        }
    }

    /// Starts a capture with the rows before, unless one runs.
    fn trigger(&mut self, why: &str, now_ms: u64) {
        if self.capture.is_some() {
            return;
        }
        let mut provenance = Box::new(self.provenance(None));
        provenance.notes.push(format!("triggered capture: {why}"));
        // One shot: on a sick lung each capture would be followed by the next one, until the disk is full.
        self.triggers = Triggers::default();
        let (which, path) = (Which::Capture, self.path("capture", now_ms));
        let (file, room) = (RecordedFile::new(path.clone(), why), self.writer.has_room());
        self.writer.give(Job::Open { which, path, provenance, mcap: None });
        (self.capture, self.left) = (Some(file), self.ticks(AROUND_S.1) as u64);
        self.add(which, self.before.iter().copied().collect(), room, now_ms);
    }

    /// What has happened since the last call; never waits.
    pub fn notices(&mut self) -> Vec<Notice> {
        loop {
            match self.writer.report() {
                Ok(Some(report)) => self.reported(report),
                Ok(None) => break,
                Err(error) => {
                    self.failed(Which::Recording, &error);
                    self.failed(Which::Capture, &error);
                    break;
                }
            }
        }
        std::mem::take(&mut self.notices)
    }

    fn reported(&mut self, report: Report) {
        match report {
            Report::Opened(which) => {
                if let Some(file) = self.slot(which).as_mut().filter(|file| file.takes()) {
                    file.stage = Stage::Open;
                }
                if which == Which::Recording {
                    self.notices.push(self.started());
                }
            }
            Report::NotOpened(Which::Recording, error) => {
                self.notices.push(Notice::Started(Err(error.to_string())));
                if self.recording.take().is_some_and(|file| !file.takes()) {
                    self.notices.push(Notice::Stopped(Err(error.to_string())));
                }
            }
            Report::NotOpened(Which::Capture, error) | Report::Failed(Which::Capture, error) => {
                self.failed(Which::Capture, &error);
            }
            Report::Failed(Which::Recording, error) => self.failed(Which::Recording, &error),
            Report::Closed(Which::Recording) => {
                let content = self.recording.take().map(|file| file.content());
                self.notices.extend(content.map(|content| Notice::Stopped(Ok(content))));
            }
            Report::Closed(Which::Capture) => {
                let content = self.capture.take().map(|file| file.content());
                let notice = content
                    .map(|content| Notice::Event(format!("capture: {content}; the triggers are disarmed")));
                self.notices.extend(notice);
            }
            Report::McapFailed(error) => {
                self.mcap = false;
                self.notices.push(Notice::Event(format!("the MCAP file ends here: {error}")));
            }
        }
    }

    /// A file is given up.
    fn failed(&mut self, which: Which, error: &RecordError) {
        let Some(file) = self.slot(which).take() else { return };
        self.notices.push(match which {
            Which::Recording if file.takes() => Notice::Event(format!("the recording ends here: {error}")),
            Which::Recording => Notice::Stopped(Err(error.to_string())),
            Which::Capture => Notice::Event(format!("a capture ({}) could not be written: {error}", file.by)),
        });
    }

    fn slot(&mut self, which: Which) -> &mut Option<RecordedFile> {
        match which {
            Which::Recording => &mut self.recording,
            Which::Capture => &mut self.capture,
        }
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
        provenance.weights_id = weights.map_or_else(String::new, |id| ImageId(id).to_string());
        provenance.settings = Value::Null;
        provenance
    }
}

impl Drop for Recorder {
    /// Finishes what is being written, all that waits included.
    fn drop(&mut self) {
        self.close(Which::Recording);
        self.close(Which::Capture);
        for report in self.writer.end() {
            if let Report::NotOpened(_, error) | Report::Failed(_, error) | Report::McapFailed(error) = report
            {
                tracing::error!(%error, "a recording could not be finished");
            }
        }
    }
}

#[cfg(test)]
mod tests;
