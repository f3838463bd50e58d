//! Reading a device's flight recorder, while it ventilates or after it was reset.

use progress::{Progress, Stage, Task};
use serde::Serialize;
use shared::link::messages::{Request, Response};
use shared::recorder::entry::{EVENT_BYTES, TICK_BYTES};
use shared::recorder::{Held, LogEntry, RecorderPart, RecorderStatus, SLOW_STRIDE, TickEntry};

use super::{Device, DeviceError};

/// What a flight recorder held.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Blackbox {
    /// What its recording is about.
    pub status: RecorderStatus,
    /// Control period, microseconds.
    pub period_us: u32,
    /// Every control tick of the last 2 s.
    pub fast: RecordedTicks,
    /// Every 20th of the last 60 s, each with the highest pressure of the 20.
    pub slow: RecordedTicks,
    /// What happened, oldest first.
    pub log: Vec<LogEntry>,
    /// Events that were damaged, or are of a kind that this program does not know.
    pub unread: usize,
}

/// Ticks in order.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedTicks {
    /// Seconds from one entry to the next.
    pub step_s: f64,
    /// Entries; none marks a gap, where the recording had stood still.
    pub entries: Vec<Option<TickEntry>>,
}

impl RecordedTicks {
    /// Entries of a part, with their distance in seconds.
    fn of(bytes: &[u8], step_s: f64) -> Self {
        let entries = bytes.as_chunks::<TICK_BYTES>().0.iter().map(|entry| TickEntry::read(*entry)).collect();
        Self { step_s, entries }
    }

    /// Entries with their time, s: the newest is at 0, gaps take no time.
    pub fn timed(&self) -> impl Iterator<Item = (f64, Option<&TickEntry>)> {
        let ticks = self.entries.iter().flatten().count() as f64;
        let mut passed = 0.0;
        self.entries.iter().map(move |entry| {
            passed += f64::from(u8::from(entry.is_some()));
            ((passed - ticks) * self.step_s, entry.as_ref())
        })
    }

    /// Ticks without the gaps.
    pub fn ticks(&self) -> impl Iterator<Item = &TickEntry> {
        self.entries.iter().flatten()
    }
}

impl Device {
    /// What the flight recorder is about.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn recorder(&mut self) -> Result<RecorderStatus, DeviceError> {
        match self.request(&Request::GetRecorder)? {
            Response::Recorder(status) => Ok(status),
            _ => Err(DeviceError::Unexpected),
        }
    }

    /// Reads all that the flight recorder holds. A device that ventilates goes on; what it records meanwhile is left for
    /// the next time.
    ///
    /// # Errors
    /// [`DeviceError`]; a request to stop is [`DeviceError::Stopped`].
    pub fn blackbox(&mut self, progress: &Progress<'_>) -> Result<Blackbox, DeviceError> {
        let period_us = self.identify()?.period_us;
        let status = self.recorder()?;
        // The ring that turns fastest first.
        let held = [status.fast, status.slow, status.log].map(|held| (held.next - held.first) as usize);
        let task = progress.task(Stage::ReadRecorder, held.iter().sum());
        let fast = self.part(RecorderPart::Fast, status.fast, &task)?;
        let slow = self.part(RecorderPart::Slow, status.slow, &task)?;
        let log = self.part(RecorderPart::Log, status.log, &task)?;
        task.finish();
        let events: Vec<_> =
            log.as_chunks::<EVENT_BYTES>().0.iter().map(|entry| LogEntry::read(*entry)).collect();
        let unread = events.iter().filter(|event| event.is_none()).count();
        let tick_s = f64::from(period_us) * 1e-6;
        Ok(Blackbox {
            status,
            period_us,
            fast: RecordedTicks::of(&fast, tick_s),
            slow: RecordedTicks::of(&slow, tick_s * f64::from(SLOW_STRIDE)),
            log: events.into_iter().flatten().collect(),
            unread,
        })
    }

    /// Bytes of the entries that a part held, as far as they are still there.
    fn part(&mut self, part: RecorderPart, held: Held, task: &Task<'_>) -> Result<Vec<u8>, DeviceError> {
        let length = if part == RecorderPart::Log { EVENT_BYTES } else { TICK_BYTES };
        let (mut from, mut bytes) = (held.first, Vec::new());
        while from < held.next {
            if task.stopped() {
                return Err(DeviceError::Stopped);
            }
            let page = match self.request(&Request::ReadRecorder { part, from })? {
                Response::Recorded(page) if page.part == part => page,
                _ => return Err(DeviceError::Unexpected),
            };
            if page.first != from {
                // The oldest were overwritten meanwhile, and what came before them does not join on.
                bytes.clear();
            }
            let count = (page.bytes.len() / length) as u32;
            let wanted = held.next.saturating_sub(page.first).min(count);
            if wanted == 0 {
                break;
            }
            bytes.extend_from_slice(&page.bytes[..wanted as usize * length]);
            task.advance((page.first + wanted - from) as usize);
            from = page.first + wanted;
        }
        Ok(bytes)
    }

    /// Empties the recording of ticks; the log stays. A recording that runs goes on.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn clear_recorder(&mut self) -> Result<(), DeviceError> {
        self.expect(&Request::ClearRecorder, |answer| matches!(answer, Response::Done))
    }
}
