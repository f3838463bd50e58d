//! The flight recorder: it keeps the last control ticks before a fault and a log of events in memory that survives a reset.
//!
//! | part | contains | entry |
//! |---|---|---|
//! | [`RecorderPart::Fast`] | the last 2,000 control ticks of a ventilation: 2 s | [`TickEntry`], 6 bytes |
//! | [`RecorderPart::Slow`] | every 20th tick of the last 60 s (30 with the feature `short-recorder`), with the highest pressure of 20 | [`TickEntry`], 6 bytes |
//! | [`RecorderPart::Log`] | the last 1,024 events | [`LogEntry`], 12 bytes |
//!
//! # When it records
//! Ticks are recorded during ventilation and for a short time afterwards ([`FAST_TAIL`], [`SLOW_TAIL`]), to show how the
//! pressure responded to the safe state. Then recording stops, so that the time before a fault can be read until
//! ventilation starts again or a host clears the recording. The event log is never stopped.
//!
//! # What survives
//! [`RecorderMemory`] is in memory that the program's start does not initialise. [`Recorder::attach`] keeps its content
//! after a reset, and clears it after power-up or if its layout is another. A reset during a write loses at most that
//! entry. A recording that is still running at the start shows that the device was reset while it ventilated.
//!
//! A loss of the supply clears the memory. So [`keeper::Keeper`] copies it to flash when ventilation has ended, and after a
//! power-up [`Recorder::attach`] continues from that copy.
//!
//! # Writer and readers
//! Only the control task writes ([`Recorder`]), with a bounded number of stores per tick. Any task may read
//! ([`RecorderMemory::status`], [`RecorderMemory::page`]); a reader that the writer overtakes detects it and reads again,
//! so the writer never waits.

pub(crate) mod cell;
mod copy;
pub mod entry;
pub mod keeper;
mod ring;
#[cfg(test)]
mod tests;
mod writer;

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::checksum::fnv;
use crate::safety::alarms::Fault;
use cell::Word;
pub use entry::{Activity, ChipEvent, Happening, LogEntry, TickEntry};
use entry::{EVENT_HALVES, TICK_HALVES, variant};
use ring::Ring;
pub use writer::{Boot, LOG_INTERVAL, Recorder, RecorderInput};

/// Capacity of [`RecorderPart::Fast`], ticks.
pub const FAST_ENTRIES: usize = 2000;
/// Capacity of [`RecorderPart::Slow`], entries.
pub const SLOW_ENTRIES: usize = if cfg!(feature = "short-recorder") { SHORT_SLOW_ENTRIES } else { 3000 };
/// The same with the feature `short-recorder`.
pub const SHORT_SLOW_ENTRIES: usize = 1500;
/// Capacity of [`RecorderPart::Log`], events.
pub const LOG_ENTRIES: usize = 1024;
/// Ticks per entry of [`RecorderPart::Slow`].
pub const SLOW_STRIDE: u32 = 20;
/// Ticks for which [`RecorderPart::Fast`] continues after ventilation has ended.
pub const FAST_TAIL: u32 = 500;
/// Ticks for which [`RecorderPart::Slow`] continues after ventilation has ended.
pub const SLOW_TAIL: u32 = 15_000;
/// Most bytes of a page: a multiple of both entry lengths.
pub const PAGE_BYTES: usize = 216;
/// Most bytes of RAM that the recorder may use.
pub const BYTES: usize = 64 * 1024;

/// Marks memory that this program wrote.
const MAGIC: u32 = 0x4575_7042;
/// Version of the layout; change it when a bit changes its meaning but no size in [`LAYOUT`] changes.
const VERSION: u32 = 1;
/// Hash of the layout; memory with another layout is cleared.
const LAYOUT: u32 = fnv(&[
    VERSION,
    size_of::<RecorderMemory>() as u32,
    FAST_ENTRIES as u32,
    SLOW_ENTRIES as u32,
    LOG_ENTRIES as u32,
    SLOW_STRIDE,
]);
/// Request to the writer to clear the recording.
const CLEAR: u32 = 0x434C_4541;

const _: () = assert!(size_of::<RecorderMemory>() <= BYTES);

/// A part of the recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RecorderPart {
    /// Every control tick.
    Fast,
    /// Every 20th control tick.
    Slow,
    /// Log of events.
    Log,
}

/// State of the recording of ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RecordingState {
    /// Nothing was recorded.
    Nothing,
    /// It is running: the device ventilates.
    Running,
    /// Ventilation was stopped.
    Stopped,
    /// A fault ended ventilation.
    Fault(Fault),
    /// A reset ended ventilation.
    Reset,
}

impl RecordingState {
    const FAULTS: u8 = 16;

    fn code(self) -> u8 {
        match self {
            Self::Nothing => 1,
            Self::Running => 2,
            Self::Stopped => 3,
            Self::Reset => 4,
            Self::Fault(fault) => Self::FAULTS + fault as u8,
        }
    }

    fn of(code: u8) -> Option<Self> {
        match code {
            1 => Some(Self::Nothing),
            2 => Some(Self::Running),
            3 => Some(Self::Stopped),
            4 => Some(Self::Reset),
            code => variant(code.checked_sub(Self::FAULTS)?).map(Self::Fault),
        }
    }
}

/// Range of a part's entries: from `first` to before `next`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    /// Number of the oldest entry.
    pub first: u32,
    /// Number of the next entry to be written.
    pub next: u32,
    /// Control tick of entry 0, wrapping, from which [`Held::tick`] computes the ticks of entries after the last gap.
    /// Unused for the log, whose entries contain their tick.
    pub origin: u32,
}

impl Held {
    /// Control tick of an entry after the last gap; `stride` is the number of ticks per entry.
    pub fn tick(&self, number: u32, stride: u32) -> u32 {
        self.origin.wrapping_add(number.wrapping_mul(stride))
    }
}

/// Status of the recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecorderStatus {
    /// Starts of the device since its log began: when its memory last lost power without a copy in flash.
    pub boot: u16,
    /// State of the recording of ticks.
    pub recording: RecordingState,
    /// Control tick since the device's start at which ventilation ended (or began, while the recording is running).
    pub tick: u32,
    /// Number of the start from which `tick` counts.
    pub tick_boot: u16,
    /// Entries of [`RecorderPart::Fast`].
    pub fast: Held,
    /// Entries of [`RecorderPart::Slow`].
    pub slow: Held,
    /// Entries of [`RecorderPart::Log`].
    pub log: Held,
}

/// Consecutive entries of a part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Page {
    /// Part of the recorder.
    pub part: RecorderPart,
    /// Number of the first entry: the requested one, or the oldest available one.
    pub first: u32,
    /// The entries, see [`TickEntry::read`] and [`LogEntry::read`]; empty if there are no more.
    pub bytes: Vec<u8, PAGE_BYTES>,
}

/// The recorder's memory. With any content, [`Recorder::attach`] makes it usable.
#[derive(Debug)]
#[repr(C)]
pub struct RecorderMemory {
    magic: Word,
    layout: Word,
    /// Number of starts, and its complement.
    boots: Word,
    /// Code of [`RecordingState`], the number of its start, and a check of both.
    recording: Word,
    /// See [`RecorderStatus::tick`].
    tick: Word,
    /// [`CLEAR`] until the writer has cleared the recording.
    clear: Word,
    fast: Ring<{ FAST_ENTRIES + 1 }, TICK_HALVES>,
    slow: Ring<{ SLOW_ENTRIES + 1 }, TICK_HALVES>,
    log: Ring<{ LOG_ENTRIES + 1 }, EVENT_HALVES>,
}

impl RecorderMemory {
    /// Memory filled with zeros.
    pub const fn new() -> Self {
        Self {
            magic: Word::new(),
            layout: Word::new(),
            boots: Word::new(),
            recording: Word::new(),
            tick: Word::new(),
            clear: Word::new(),
            fast: Ring::new(),
            slow: Ring::new(),
            log: Ring::new(),
        }
    }

    /// Whether the content was left by a program with this layout.
    fn is_sound(&self) -> bool {
        let rings = self.fast.is_sound() && self.slow.is_sound() && self.log.is_sound();
        let header = self.magic.load() == MAGIC && self.layout.load() == LAYOUT;
        header && rings && self.boots().is_some() && self.recording().is_some()
    }

    /// Formats it as an empty recorder, valid only after the last store.
    fn format(&self) {
        self.magic.store(0);
        self.layout.store(LAYOUT);
        self.fast.format();
        self.slow.format();
        self.log.format();
        self.tick.store(0);
        self.clear.store(0);
        self.set_boots(0);
        self.set_recording(RecordingState::Nothing, 0);
        self.magic.store(MAGIC);
    }

    fn boots(&self) -> Option<u16> {
        let word = self.boots.load();
        (word as u16 == !(word >> 16) as u16).then_some(word as u16)
    }

    fn set_boots(&self, boots: u16) {
        self.boots.store(u32::from(boots) | u32::from(!boots) << 16);
    }

    /// State of the recording, and the number of its start.
    fn recording(&self) -> Option<(RecordingState, u16)> {
        let [code, low, high, check] = self.recording.load().to_le_bytes();
        let recording = RecordingState::of(code).filter(|_| check == code ^ low ^ high ^ 0xA5)?;
        Some((recording, u16::from_le_bytes([low, high])))
    }

    fn set_recording(&self, recording: RecordingState, boot: u16) {
        let (code, [low, high]) = (recording.code(), boot.to_le_bytes());
        self.recording.store(u32::from_le_bytes([code, low, high, code ^ low ^ high ^ 0xA5]));
    }

    /// Requests the writer to clear the recording of ticks in the next tick; the log stays.
    pub fn request_clear(&self) {
        self.clear.store(CLEAR);
    }

    /// Status of the recorder.
    pub fn status(&self) -> RecorderStatus {
        let cleared = self.clear.load() == CLEAR;
        // The writer keeps the state valid; an invalid state counts as no recording.
        let (recording, tick_boot) = self.recording().unwrap_or((RecordingState::Nothing, 0));
        let recording =
            if cleared && recording != RecordingState::Running { RecordingState::Nothing } else { recording };
        let ticks = |held: Held| if cleared { Held { first: held.next, ..held } } else { held };
        RecorderStatus {
            boot: self.boots().unwrap_or(0),
            recording,
            tick: self.tick.load(),
            tick_boot,
            fast: ticks(self.fast.held()),
            slow: ticks(self.slow.held()),
            log: self.log.held(),
        }
    }

    /// Reads entries of a part, starting at this number or at the oldest available one.
    pub fn page(&self, part: RecorderPart, from: u32) -> Page {
        let (first, bytes) = match part {
            RecorderPart::Fast => self.fast.read(from),
            RecorderPart::Slow => self.slow.read(from),
            RecorderPart::Log => self.log.read(from),
        };
        Page { part, first, bytes }
    }
}

impl Default for RecorderMemory {
    fn default() -> Self {
        Self::new()
    }
}
