//! Replays of recordings and of flight recorders, in the time in which they were recorded, again and again.

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant};

use data::recording::{Recording, numbered_phase};
use serde::Deserialize;
use shared::breath::{DEFAULT_PERIOD_US, Phase};
use shared::link::messages::{Event, Request, Response};
use shared::link::telemetry::{BATCH_SAMPLES, Counters, PackedSample, TelemetryBatch};
use shared::recorder::LogEntry;
use shared::settings::Settings;
use shared::ventilator::{Mode, Sample};
use show::monitor::News;
use thiserror::Error;

use crate::flight_recorder::events;
use crate::source::{Source, Unable, Watch};
use crate::stream::Kind;
use crate::verdict::verdict;
use device::LineCounters;

/// Pause before a replay starts again, s.
const PAUSE_S: f64 = 1.0;
/// Interval of the state, in which a replay always ventilates.
const STATE_EVERY: Duration = Duration::from_millis(500);
/// Most lag that is caught up, s: a computer that was asleep does not replay hours at once.
const LAG_S: f64 = 1.0;

/// Why a file cannot be replayed.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is no flight recorder.
    #[error(
        "{} is not a flight recorder: {source}; `trainer blackbox --port PORT --out FILE.json` writes one",
        path.display()
    )]
    Blackbox {
        /// The file.
        path: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
    /// There is nothing to show.
    #[error("{0} contains no ticks of a ventilation")]
    Empty(String),
}

/// Samples with their ticks, which ascend.
type Ticks = Vec<(u64, Sample)>;

/// Watches a recording, and judges it.
///
/// # Errors
/// [`ReplayError::Empty`].
pub fn recording(name: &str, recording: &Recording) -> Result<Watch, ReplayError> {
    let settings = serde_json::from_value(recording.provenance.settings.clone()).ok();
    let watch = watch(name.to_owned(), recording.provenance.period_us, ticks(recording), settings)?;
    Ok(Watch { verdict: Some(verdict(recording)), ..watch })
}

/// Watches a flight recorder that `trainer blackbox --out FILE.json` has written: its last seconds tick by tick and, if it has them,
/// its last minute at a twentieth of the rate, both with its event log.
///
/// # Errors
/// [`ReplayError`].
pub fn blackbox(path: &Path) -> Result<Vec<Watch>, ReplayError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| ReplayError::Read { path: path.to_owned(), source })?;
    let found: Blackbox = serde_json::from_str(&text)
        .map_err(|source| ReplayError::Blackbox { path: path.to_owned(), source })?;
    let name = path.display();
    let recorder = events(&found.log, found.period_us.unwrap_or(DEFAULT_PERIOD_US));
    let parts = [(format!("{name}, last seconds"), found.fast), (format!("{name}, last minute"), found.slow)];
    let watches: Vec<Watch> = parts
        .into_iter()
        .filter_map(|(name, part)| watch(name, (part.step_s * 1e6).round() as u32, part.ticks(), None).ok())
        .map(|watch| Watch { recorder: Some(recorder.clone()), ..watch })
        .collect();
    if watches.is_empty() { Err(ReplayError::Empty(name.to_string())) } else { Ok(watches) }
}

fn watch(
    name: String,
    period_us: u32,
    ticks: Ticks,
    settings: Option<Settings>,
) -> Result<Watch, ReplayError> {
    if ticks.is_empty() || period_us == 0 {
        return Err(ReplayError::Empty(name));
    }
    let source = Box::new(Replay::new(period_us, ticks, settings));
    Ok(Watch { name, kind: Kind::Recording, period_us, source, verdict: None, recorder: None })
}

/// The rows of a recording, with breaths one after the other.
fn ticks(recording: &Recording) -> Ticks {
    let (mut ticks, mut start, mut breath) = (Ticks::new(), 0, None);
    for row in (0..recording.len()).filter_map(|row| recording.row(row)) {
        if breath.is_some_and(|breath| breath != row.breath) {
            start = ticks.last().map_or(0, |(tick, _)| tick + 1);
        }
        breath = Some(row.breath);
        let sample = Sample {
            breath: row.breath,
            tick: row.tick,
            // A file has no other numbers.
            phase: numbered_phase(row.phase).unwrap_or(Phase::Inspiration),
            target: row.target,
            pressure: row.pressure,
            u_in: row.u_in,
            u_out: row.u_out > 50.0,
            explore: row.explore,
            // A recording does not hold it.
            learned: f32::NAN,
            flow: None,
        };
        ticks.push((start + u64::from(row.tick), sample));
    }
    ticks
}

/// The part of a flight recorder's file that is shown.
#[derive(Debug, Deserialize)]
struct Blackbox {
    period_us: Option<u32>,
    fast: Part,
    slow: Part,
    #[serde(default)]
    log: Vec<LogEntry>,
}

#[derive(Debug, Deserialize)]
struct Part {
    step_s: f64,
    entries: Vec<Option<Entry>>,
}

#[derive(Debug, Deserialize)]
struct Entry {
    pressure: Option<f32>,
    target: Option<f32>,
    u_in: f32,
    u_out: bool,
    phase: Option<Phase>,
    breath: u8,
}

impl Part {
    /// Its ticks; those outside a breath and gaps are missing.
    fn ticks(&self) -> Ticks {
        let (mut ticks, mut number, mut place, mut breath) = (Ticks::new(), 0_u32, 1_u32, None);
        for (tick, entry) in (0..).zip(&self.entries) {
            let Some((entry, phase)) = entry.as_ref().and_then(|entry| Some((entry, entry.phase?))) else {
                // What follows does not start a breath.
                (breath, place) = (None, 1);
                continue;
            };
            if breath.is_some_and(|breath| breath != entry.breath) {
                (number, place) = (number + 1, 0);
            }
            breath = Some(entry.breath);
            let sample = Sample {
                breath: number,
                tick: place,
                phase,
                target: entry.target.unwrap_or(f32::NAN),
                pressure: entry.pressure.unwrap_or(f32::NAN),
                u_in: entry.u_in,
                u_out: entry.u_out,
                explore: 0.0,
                learned: f32::NAN,
                flow: None,
            };
            ticks.push((tick, sample));
            place += 1;
        }
        ticks
    }
}

/// A running replay.
struct Replay {
    period_s: f64,
    ticks: Ticks,
    settings: Option<Settings>,
    /// The next sample, and the tick at which the running round began.
    place: usize,
    round: u64,
    /// When tick 0 was.
    started: Instant,
    reported: Option<Instant>,
    waiting: VecDeque<News>,
}

impl Replay {
    fn new(period_us: u32, mut ticks: Ticks, settings: Option<Settings>) -> Self {
        let first = ticks.first().map_or(0, |(tick, _)| *tick);
        for (tick, _) in &mut ticks {
            *tick -= first;
        }
        Self {
            period_s: f64::from(period_us) * 1e-6,
            ticks,
            settings,
            place: 0,
            round: 0,
            started: Instant::now(),
            reported: None,
            waiting: VecDeque::new(),
        }
    }

    /// What a device would answer.
    fn report_state(&mut self) {
        self.reported = Some(Instant::now());
        let mut answer = |request, response| {
            self.waiting.push_back(News::Answer { request, result: Ok(response) });
        };
        answer(Request::Start, Response::Mode(Mode::Ventilating));
        if let Some(in_force) = self.settings {
            answer(Request::GetSettings, Response::Settings { in_force, pending: None });
        }
        self.waiting.push_back(News::Traffic(LineCounters::default()));
    }

    /// Makes batches of the samples that are due.
    fn advance(&mut self) {
        let now = self.started.elapsed().as_secs_f64();
        let next = self.next_tick() as f64 * self.period_s;
        if now - next > LAG_S {
            self.started += Duration::from_secs_f64(now - next);
            return;
        }
        let due = (now / self.period_s) as u64;
        while self.next_tick() <= due {
            self.batch(due);
        }
    }

    fn next_tick(&self) -> u64 {
        self.round + self.ticks[self.place].0
    }

    /// Makes a batch of consecutive samples up to a tick.
    fn batch(&mut self, due: u64) {
        let first_tick = self.next_tick();
        let counters = Counters::default();
        let mut batch = TelemetryBatch { sequence: 0, first_tick, counters, samples: heapless::Vec::new() };
        while self.next_tick() == first_tick + batch.samples.len() as u64
            && self.next_tick() <= due
            && batch.samples.len() < BATCH_SAMPLES
        {
            let sample = PackedSample::pack(&self.ticks[self.place].1);
            // There is room.
            let _ = batch.samples.push(sample);
            self.place += 1;
            if self.place == self.ticks.len() {
                self.round += self.ticks[self.place - 1].0 + (PAUSE_S / self.period_s).ceil() as u64;
                self.place = 0;
                break;
            }
        }
        self.waiting.push_back(News::Event(Event::Telemetry(batch)));
    }
}

impl Source for Replay {
    fn next(&mut self, patience: Duration) -> Option<News> {
        if self.reported.is_none_or(|at| at.elapsed() >= STATE_EVERY) {
            self.report_state();
        }
        if self.waiting.is_empty() {
            self.advance();
        }
        if self.waiting.is_empty() && !patience.is_zero() {
            sleep(patience);
            self.advance();
        }
        self.waiting.pop_front()
    }

    fn ask(&mut self, _request: Request) -> Result<(), Unable> {
        Err(Unable::Replay)
    }

    fn leave(self: Box<Self>) {}
}

#[cfg(test)]
mod tests;
