//! Reads a device's flight recorder, while it ventilates or after it was reset.

use progress::{Progress, Stage};
use serde::Serialize;
use shared::link::messages::{Request, Response};
use shared::recorder::entry::{EVENT_BYTES, TICK_BYTES};
use shared::recorder::{
    ChipEvent, FAST_ENTRIES, Happening, Held, LOG_ENTRIES, LogEntry, Page, RecorderPart, RecorderStatus,
    SLOW_ENTRIES, SLOW_STRIDE, TickEntry,
};

use super::answers::unexpected;
use super::{Device, DeviceError};

/// Reading a flight recorder: entries.
pub const READ_RECORDER: Stage = Stage("read flight recorder");

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

/// A reading of a flight recorder, page by page: what to ask for next, and what has come so far. It has neither line nor clock, so that
/// it can run between other requests.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    status: RecorderStatus,
    parts: [PartRead; 3],
}

/// A part of a flight recorder that is being read.
#[derive(Debug, Clone, PartialEq)]
struct PartRead {
    part: RecorderPart,
    /// Length of an entry, bytes.
    length: usize,
    /// The next entry to read, and the first one that the part had not yet when the reading began.
    next: u32,
    end: u32,
    bytes: Vec<u8>,
}

impl PartRead {
    /// Begins with what a part holds, at most `most` entries.
    fn new(part: RecorderPart, held: Held, length: usize, most: usize) -> Self {
        let next = held.first.max(held.next.saturating_sub(most as u32));
        Self { part, length, next, end: held.next, bytes: Vec::new() }
    }

    fn left(&self) -> u32 {
        self.end.saturating_sub(self.next)
    }

    /// Adds a page; false if it is from before what was asked for.
    fn add(&mut self, page: &Page) -> bool {
        if page.first < self.next {
            return false;
        }
        if page.first > self.next {
            // The oldest entries were overwritten meanwhile, so the earlier bytes are no longer contiguous.
            self.bytes.clear();
        }
        let wanted = self.end.saturating_sub(page.first) as usize;
        let count = wanted.min(page.bytes.len() / self.length);
        self.bytes.extend_from_slice(&page.bytes[..count * self.length]);
        // An empty page means that there are no more.
        self.next = if count == 0 { self.end } else { page.first + count as u32 };
        true
    }
}

impl Reading {
    /// Begins with what the recorder holds.
    pub fn new(status: RecorderStatus) -> Self {
        use RecorderPart::{Fast, Log, Slow};
        // The ring first that is overwritten fastest.
        let parts = [
            PartRead::new(Fast, status.fast, TICK_BYTES, FAST_ENTRIES),
            PartRead::new(Slow, status.slow, TICK_BYTES, SLOW_ENTRIES),
            PartRead::new(Log, status.log, EVENT_BYTES, LOG_ENTRIES),
        ];
        Self { status, parts }
    }

    /// Number of entries that are still to be read.
    pub fn left(&self) -> usize {
        self.parts.iter().map(|part| part.left() as usize).sum()
    }

    /// The next request; none if all is read.
    pub fn request(&self) -> Option<Request> {
        let PartRead { part, next, .. } = self.parts.iter().find(|part| part.left() > 0)?;
        Some(Request::ReadRecorder { part: *part, from: *next })
    }

    /// Takes the answer to [`Self::request`]; false if it answers something else.
    pub fn take(&mut self, page: &Page) -> bool {
        let reading = self.parts.iter_mut().find(|part| part.left() > 0);
        reading.is_some_and(|part| part.part == page.part && part.add(page))
    }

    /// What was read; a control tick lasts `period_us` microseconds.
    pub fn finish(self, period_us: u32) -> Blackbox {
        let [fast, slow, log] = self.parts.map(|part| part.bytes);
        let events: Vec<_> =
            log.as_chunks::<EVENT_BYTES>().0.iter().map(|entry| LogEntry::read(*entry)).collect();
        let unread = events.iter().filter(|event| event.is_none()).count();
        let log: Vec<LogEntry> = events.into_iter().flatten().collect();
        let tick_s = f64::from(period_us) * 1e-6;
        Blackbox {
            status: self.status,
            period_us,
            fast: RecordedTicks::of(&fast, tick_s),
            slow: RecordedTicks::of(&slow, tick_s * f64::from(SLOW_STRIDE)),
            from_flash: is_restored(&log, self.status.tick_boot),
            log,
            unread,
        }
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
            other => Err(unexpected(&Request::GetRecorder, &other)),
        }
    }

    /// Reads the whole flight recorder. A ventilating device continues; ticks that it records meanwhile are not
    /// included.
    ///
    /// # Errors
    /// [`DeviceError`]; a request to stop is [`DeviceError::Stopped`].
    pub fn blackbox(&mut self, progress: &Progress<'_>) -> Result<Blackbox, DeviceError> {
        let period_us = self.identify()?.period_us;
        let mut reading = Reading::new(self.recorder()?);
        let task = progress.task(READ_RECORDER, reading.left());
        while let Some(request) = reading.request() {
            if task.stopped() {
                return Err(DeviceError::Stopped);
            }
            let left = reading.left();
            match self.request(&request)? {
                Response::Recorded(page) if reading.take(&page) => task.advance(left - reading.left()),
                other => return Err(unexpected(&request, &other)),
            }
        }
        task.finish();
        Ok(reading.finish(period_us))
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
    use shared::recorder::RecorderPart::{Fast, Log, Slow};
    use shared::recorder::RecordingState;

    #[test]
    fn a_recording_is_from_flash_only_if_it_was_restored_after_its_start() {
        let restored = Happening::Chip(ChipEvent::RecorderRestored);
        let at = |boot, happening| LogEntry { tick: 0, boot, happening };
        let log = [at(1, Happening::Start), at(2, restored), at(3, Happening::Start)];
        assert_eq!([1, 2, 3].map(|recorded| is_restored(&log, recorded)), [true, false, false]);
        assert!(!is_restored(&log[..1], 1) && is_restored(&[at(0, restored)], u16::MAX));
    }

    /// A reading of a recorder that holds these entries of its fast ring and of its log.
    fn reading(fast: [u32; 2], log: [u32; 2]) -> Reading {
        let held = |[first, next]: [u32; 2]| Held { first, next, origin: 0 };
        let (recording, boot, tick, tick_boot) = (RecordingState::Nothing, 1, 0, 1);
        let (fast, slow, log) = (held(fast), Held::default(), held(log));
        Reading::new(RecorderStatus { recording, boot, tick, tick_boot, fast, slow, log })
    }

    /// A page of ticks, or of events, each of which begins with its number.
    fn page(part: RecorderPart, first: u32, entries: usize) -> Page {
        let length = if part == Log { EVENT_BYTES } else { TICK_BYTES };
        let byte =
            |place: usize| if place.is_multiple_of(length) { first as usize + place / length } else { 0 };
        Page { part, first, bytes: (0..entries * length).map(|place| byte(place) as u8).collect() }
    }

    fn asks(reading: &Reading) -> Option<(RecorderPart, u32)> {
        match reading.request()? {
            Request::ReadRecorder { part, from } => Some((part, from)),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn parts_are_read_page_by_page_up_to_the_end_at_the_start() {
        let mut reading = reading([0, 50], [5, 30]);
        // The slow ring is empty.
        for (part, first, entries, left) in
            [(Fast, 0, 30, 45), (Fast, 30, 30, 25), (Log, 5, 18, 7), (Log, 23, 18, 0)]
        {
            assert_eq!(asks(&reading), Some((part, first)));
            assert!(reading.take(&page(part, first, entries)));
            assert_eq!(reading.left(), left);
        }
        assert_eq!(asks(&reading), None);
        let read = reading.finish(1000);
        assert_eq!((read.fast.entries.len(), read.slow.entries.len()), (50, 0));
        assert_eq!((read.fast.step_s, read.slow.step_s, read.log.len() + read.unread), (0.001, 0.02, 25));
    }

    #[test]
    fn what_was_read_before_entries_that_were_overwritten_is_left_out() {
        let mut reading = reading([0, 80], [0, 0]);
        for (first, entries) in [(0, 30), (50, 20), (70, 30)] {
            assert!(reading.take(&page(Fast, first, entries)));
        }
        assert_eq!(asks(&reading), None);
        assert_eq!(reading.finish(1000).fast, RecordedTicks::of(&page(Fast, 50, 30).bytes, 0.001));
    }

    #[test]
    fn whatever_pages_come_a_reading_ends() {
        // What it claims to hold is limited to what it can hold.
        let oldest = u32::MAX - LOG_ENTRIES as u32;
        let begun = reading([9, 3], [0, u32::MAX]);
        assert_eq!(asks(&begun), Some((Log, oldest)));
        for (wrong, why) in [
            (page(Log, 3, 18), "from before"),
            (page(Slow, oldest, 18), "another part"),
            (page(Fast, u32::MAX, 1), "all read"),
        ] {
            assert!(!begun.clone().take(&wrong), "{why}");
        }
        let mut ended = begun;
        assert!(ended.take(&page(Log, u32::MAX - 1024, 0)), "an empty page");
        assert_eq!(asks(&ended), None);
    }
}
