//! The flight recorder: the last moments before a fault, and what happened when, in memory that survives a reset.
//!
//! | part | holds | entry |
//! |---|---|---|
//! | [`RecorderPart::Fast`] | the last 2,000 control ticks of a ventilation: 2 s | [`TickEntry`], 6 bytes |
//! | [`RecorderPart::Slow`] | every 20th tick of the last 60 s, with the highest pressure of the 20 | [`TickEntry`], 6 bytes |
//! | [`RecorderPart::Log`] | the last 1,024 events | [`LogEntry`], 12 bytes |
//!
//! # When it records
//! Ticks are recorded while the ventilator ventilates and for a short time after that ([`FAST_TAIL`], [`SLOW_TAIL`]): what
//! the pressure did when the valves went to their safe state is half of the story. Then the recording stands still, so that
//! the moments before a fault can be read at any later time, until ventilation starts again or a host empties it. The event log never
//! stands still.
//!
//! # What survives
//! [`RecorderMemory`] lies where no start of the program touches it. [`Recorder::attach`] keeps what it finds there after a reset and
//! empties it after power-up, or if it is not what this very layout left. A reset in the middle of a write loses at most
//! that entry. A start that finds a recording that never ended knows that the device was reset while it ventilated.
//!
//! # Who writes, who reads
//! The control task alone writes ([`Recorder`]), a constant handful of stores per tick. Anyone may read ([`RecorderMemory::status`],
//! [`RecorderMemory::page`]); a reader that the writer has overtaken notices it and reads again, so the writer never waits.

mod cell;
pub mod entry;
mod ring;
#[cfg(test)]
mod tests;
mod writer;

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::checksum::fnv;
use crate::safety::alarms::Fault;
use cell::Word;
pub use entry::{Activity, Happening, LogEntry, TickEntry};
use entry::{EVENT_HALVES, TICK_HALVES, variant};
use ring::Ring;
pub use writer::{Boot, Moment, Recorder};

/// Ticks that [`RecorderPart::Fast`] holds.
pub const FAST_ENTRIES: usize = 2000;
/// Entries that [`RecorderPart::Slow`] holds.
pub const SLOW_ENTRIES: usize = 3000;
/// Events that [`RecorderPart::Log`] holds.
pub const LOG_ENTRIES: usize = 1024;
/// Ticks from one entry of [`RecorderPart::Slow`] to the next.
pub const SLOW_STRIDE: u32 = 20;
/// Ticks for which [`RecorderPart::Fast`] goes on after ventilation has ended.
pub const FAST_TAIL: u32 = 500;
/// Ticks for which [`RecorderPart::Slow`] goes on after ventilation has ended.
pub const SLOW_TAIL: u32 = 15_000;
/// Most bytes of a page: whole entries of either length.
pub const PAGE_BYTES: usize = 216;
/// Most bytes of RAM that all of this may take.
pub const BYTES: usize = 64 * 1024;

/// Marks memory that this program wrote.
const MAGIC: u32 = 0x4575_7042;
/// Changes with the meaning of any bit that the layout's numbers do not tell.
const VERSION: u32 = 1;
/// Hash of the layout: memory of another layout is emptied.
const LAYOUT: u32 = fnv(&[
    VERSION,
    size_of::<RecorderMemory>() as u32,
    FAST_ENTRIES as u32,
    SLOW_ENTRIES as u32,
    LOG_ENTRIES as u32,
    SLOW_STRIDE,
]);
/// Asks the writer to empty the recording.
const CLEAR: u32 = 0x434C_4541;

const _: () = assert!(size_of::<RecorderMemory>() <= BYTES);

/// A part of the recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RecorderPart {
    /// Every control tick.
    Fast,
    /// Every 20th.
    Slow,
    /// Events.
    Log,
}

/// State of the recording of ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RecordingState {
    /// Nothing was recorded.
    Nothing,
    /// It goes on: the device ventilates.
    Running,
    /// It ended with a stop.
    Stopped,
    /// It ended with a fault.
    Fault(Fault),
    /// It ended with a reset of the ventilating device.
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

/// Range of a part's entries: from `first` up to, but without, `next`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    /// Number of the oldest entry.
    pub first: u32,
    /// Number of the entry that comes next.
    pub next: u32,
    /// Control tick of entry 0, wrapping; with the entries' distance it gives the tick of each entry after the last gap.
    /// Entries of the log know their tick themselves.
    pub origin: u32,
}

impl Held {
    /// Control tick of an entry after the last gap; `stride` is the distance of the part's entries in ticks.
    pub fn tick(&self, number: u32, stride: u32) -> u32 {
        self.origin.wrapping_add(number.wrapping_mul(stride))
    }
}

/// Status of the recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecorderStatus {
    /// Starts of the device since its memory was last without power.
    pub boot: u16,
    /// State of the recording of ticks.
    pub recording: RecordingState,
    /// Control tick since the device's start at which it ended (or began, while it runs).
    pub tick: u32,
    /// Start of the device that `tick` counts from.
    pub tick_boot: u16,
    /// Every tick.
    pub fast: Held,
    /// Every 20th.
    pub slow: Held,
    /// Events.
    pub log: Held,
}

/// Consecutive entries of a part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Page {
    /// The part.
    pub part: RecorderPart,
    /// Number of the first entry: the one that was asked for, or the oldest that is left.
    pub first: u32,
    /// The entries, see [`TickEntry::read`] and [`LogEntry::read`]; none if there are no more.
    pub bytes: Vec<u8, PAGE_BYTES>,
}

/// The recorder's memory. Whatever lies in it, [`Recorder::attach`] makes it usable.
#[derive(Debug)]
#[repr(C)]
pub struct RecorderMemory {
    magic: Word,
    layout: Word,
    /// Number of starts, and its complement.
    boots: Word,
    /// Code of [`RecordingState`], the start that it belongs to, and their check.
    recording: Word,
    /// See [`RecorderStatus::tick`].
    tick: Word,
    /// [`CLEAR`] for one tick.
    clear: Word,
    fast: Ring<{ FAST_ENTRIES + 1 }, TICK_HALVES>,
    slow: Ring<{ SLOW_ENTRIES + 1 }, TICK_HALVES>,
    log: Ring<{ LOG_ENTRIES + 1 }, EVENT_HALVES>,
}

impl RecorderMemory {
    /// Memory as after power-up.
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

    /// Whether a program of this layout left it.
    fn is_sound(&self) -> bool {
        let rings = self.fast.is_sound() && self.slow.is_sound() && self.log.is_sound();
        let header = self.magic.load() == MAGIC && self.layout.load() == LAYOUT;
        header && rings && self.boots().is_some() && self.recording().is_some()
    }

    /// Makes it an empty recorder. It counts as one only when all of it is written.
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

    /// State of the recording, and the start that it belongs to.
    fn recording(&self) -> Option<(RecordingState, u16)> {
        let [code, low, high, check] = self.recording.load().to_le_bytes();
        let recording = RecordingState::of(code).filter(|_| check == code ^ low ^ high ^ 0xA5)?;
        Some((recording, u16::from_le_bytes([low, high])))
    }

    fn set_recording(&self, recording: RecordingState, boot: u16) {
        let (code, [low, high]) = (recording.code(), boot.to_le_bytes());
        self.recording.store(u32::from_le_bytes([code, low, high, code ^ low ^ high ^ 0xA5]));
    }

    /// Asks the writer to empty the recording of ticks with the next tick; the log stays.
    pub fn request_clear(&self) {
        self.clear.store(CLEAR);
    }

    /// Its status.
    pub fn status(&self) -> RecorderStatus {
        let cleared = self.clear.load() == CLEAR;
        // The writer leaves it readable; what cannot be read is nothing.
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

    /// Entries of a part from this number on, or from the oldest that is left.
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
