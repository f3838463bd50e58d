//! Reads a device's flight recorder, while it ventilates or after it was reset.

use progress::{Progress, Stage, Task};
use serde::Serialize;
use shared::link::messages::{Request, Response};
use shared::recorder::entry::{EVENT_BYTES, TICK_BYTES};
use shared::recorder::{
    ChipEvent, Happening, Held, LogEntry, RecorderPart, RecorderStatus, SLOW_STRIDE, TickEntry,
};

use super::{Device, DeviceError};

/// Content of a flight recorder.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Blackbox {
    /// State of its recording.
    pub status: RecorderStatus,
    /// Whether the recording was read back from its copy in flash, after a loss of the supply.
    pub from_flash: bool,
    /// Control period, microseconds.
    pub period_us: u32,
    /// Every control tick of the last 2 s.
    pub fast: RecordedTicks,
    /// Every 20th of the last 60 s, each with the highest pressure of the 20.
    pub slow: RecordedTicks,
    /// Events, oldest first.
    pub log: Vec<LogEntry>,
    /// Number of events that were damaged or of an unknown kind.
    pub unread: usize,
}

/// Recorded ticks, oldest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedTicks {
    /// Time between entries, s.
    pub step_s: f64,
    /// Entries; `None` marks a gap, during which the recording was paused.
    pub entries: Vec<Option<TickEntry>>,
}

impl RecordedTicks {
    /// Entries of a part, `step_s` seconds apart.
    fn of(bytes: &[u8], step_s: f64) -> Self {
        let entries = bytes.as_chunks::<TICK_BYTES>().0.iter().map(|entry| TickEntry::read(*entry)).collect();
        Self { step_s, entries }
    }

    /// Entries with their time, s: the newest is at 0; gaps take no time.
    pub fn timed(&self) -> impl Iterator<Item = (f64, Option<&TickEntry>)> {
        let ticks = self.entries.iter().flatten().count() as f64;
        let mut passed = 0.0;
        self.entries.iter().map(move |entry| {
            passed += f64::from(u8::from(entry.is_some()));
            ((passed - ticks) * self.step_s, entry.as_ref())
        })
    }

    /// The ticks, without gaps.
    pub fn ticks(&self) -> impl Iterator<Item = &TickEntry> {
        self.entries.iter().flatten()
    }
}

/// Whether a recording of this start was read back from flash in a later one.
fn is_restored(log: &[LogEntry], recorded: u16) -> bool {
    let restored = Happening::Chip(ChipEvent::RecorderRestored);
    log.iter().any(|event| event.happening == restored && event.boot.wrapping_sub(recorded) as i16 > 0)
}

impl Device {
    /// State of the flight recorder.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn recorder(&mut self) -> Result<RecorderStatus, DeviceError> {
        match self.request(&Request::GetRecorder)? {
            Response::Recorder(status) => Ok(status),
            _ => Err(DeviceError::Unexpected),
        }
    }

    /// Reads the whole flight recorder. A ventilating device continues; ticks that it records meanwhile are not
    /// included.
    ///
    /// # Errors
    /// [`DeviceError`]; a request to stop is [`DeviceError::Stopped`].
    pub fn blackbox(&mut self, progress: &Progress<'_>) -> Result<Blackbox, DeviceError> {
        let period_us = self.identify()?.period_us;
        let status = self.recorder()?;
        // Read the fastest ring first.
        let held = [status.fast, status.slow, status.log].map(|held| (held.next - held.first) as usize);
        let task = progress.task(Stage::ReadRecorder, held.iter().sum());
        let fast = self.part(RecorderPart::Fast, status.fast, &task)?;
        let slow = self.part(RecorderPart::Slow, status.slow, &task)?;
        let log = self.part(RecorderPart::Log, status.log, &task)?;
        task.finish();
        let events: Vec<_> =
            log.as_chunks::<EVENT_BYTES>().0.iter().map(|entry| LogEntry::read(*entry)).collect();
        let unread = events.iter().filter(|event| event.is_none()).count();
        let log: Vec<LogEntry> = events.into_iter().flatten().collect();
        let tick_s = f64::from(period_us) * 1e-6;
        Ok(Blackbox {
            status,
            period_us,
            fast: RecordedTicks::of(&fast, tick_s),
            slow: RecordedTicks::of(&slow, tick_s * f64::from(SLOW_STRIDE)),
            from_flash: is_restored(&log, status.tick_boot),
            log,
            unread,
        })
    }

    /// Bytes of the entries that a part contained, as far as they are still available.
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
                // The oldest entries were overwritten meanwhile, so the earlier bytes are no longer contiguous.
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

    /// Clears the recorded ticks; the event log stays. A running recording continues.
    ///
    /// # Errors
    /// [`DeviceError`].
    pub fn clear_recorder(&mut self) -> Result<(), DeviceError> {
        self.expect(&Request::ClearRecorder, |answer| matches!(answer, Response::Done))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_is_from_flash_only_if_it_was_restored_after_its_start() {
        let restored = Happening::Chip(ChipEvent::RecorderRestored);
        let at = |boot, happening| LogEntry { tick: 0, boot, happening };
        let log = [at(1, Happening::Start), at(2, restored), at(3, Happening::Start)];
        assert_eq!([1, 2, 3].map(|recorded| is_restored(&log, recorded)), [true, false, false]);
        assert!(!is_restored(&log[..1], 1) && is_restored(&[at(0, restored)], u16::MAX));
    }
}
