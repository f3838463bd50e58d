//! The prescription: the settings of a running ventilation, in memory that outlasts a reset and, if a cell supplies it, a power
//! cut, so that ventilation resumes after an interruption that nobody requested.
//!
//! The memory holds two copies, which are written in turn: a reset in the middle of a write leaves the other one. A copy
//! counts only with its magic word, its checksum and settings that pass validation. The end of ventilation clears both, so
//! that after a stop, a latched fault or a requested restart nothing moves by itself.
//!
//! After a power cut ventilation resumes only if a clock has measured how long the supply was away, and at most
//! [`LONGEST_ABSENCE_S`] after the last breath; a supply that returned too low must become sound within that time as well. Other
//! resets are short in themselves, so they need no clock; if there is one, the same limit applies.
//!
//! A program that fails again and again before it has completed a breath resumes [`RESUMES`] times; then it waits in standby,
//! where a host can reach it.

use super::absence::{ClockTime, LONGEST_ABSENCE_S, Notes};
use super::control::Control;
use super::{ControlReply, ControlRequest, HostRole};
use crate::checksum::{CRC_32, fnv};
use crate::link::messages::Response;
use crate::link::refusal::Refusal;
use crate::recorder::ChipEvent;
use crate::recorder::cell::Word;
use crate::recorder::keeper::Leave;
use crate::reset::ResetCause;
use crate::settings::{FIELDS, Settings};
use crate::ventilator::{Mode, Output};

/// Times that ventilation resumes after failures of the program without a completed breath in between. Fulfils: resume-count.
pub const RESUMES: u16 = 3;

/// Shortest interruption after which ventilation does not resume, s.
const LONGER_ABSENCE_S: u32 = LONGEST_ABSENCE_S + 1;
/// Number of settings.
const COUNT: usize = FIELDS.len();
/// Marks a complete copy; another layout has another one.
const MAGIC: u32 = fnv(&[0x5072_6573, 2, COUNT as u32]);

/// What a reset has interrupted ventilation by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interruption {
    /// The supply was away: the same as a first start, unless the memory tells of a ventilation.
    PowerCut,
    /// The supply fell.
    Supply,
    /// A control tick did not end, or the program failed.
    Program,
}

impl Interruption {
    /// The interruption for a start with this cause; none after a requested restart or the reset pin. `failed`: the program
    /// restarted itself after a failure; `supply_low`: that failure was the falling supply.
    pub fn of(cause: ResetCause, failed: bool, supply_low: bool) -> Option<Self> {
        match cause {
            ResetCause::PowerOn => Some(Self::PowerCut),
            ResetCause::BrownOut => Some(Self::Supply),
            ResetCause::Software if failed && supply_low => Some(Self::Supply),
            ResetCause::Software if failed => Some(Self::Program),
            ResetCause::Watchdog => Some(Self::Program),
            ResetCause::Pin | ResetCause::Software | ResetCause::Other => None,
        }
    }
}

/// A copy of the settings.
#[derive(Debug)]
#[repr(C)]
struct Copy {
    magic: Word,
    /// Higher in the copy that was written later, wrapping.
    sequence: Word,
    settings: [Word; COUNT],
    checksum: Word,
}

impl Copy {
    const fn new() -> Self {
        Self {
            magic: Word::new(),
            sequence: Word::new(),
            settings: [const { Word::new() }; COUNT],
            checksum: Word::new(),
        }
    }

    /// Sequence number and settings, if the copy is complete and undamaged and the settings are valid.
    fn read(&self) -> Option<(u32, Settings)> {
        let words = self.settings.each_ref().map(Word::load);
        let sequence = self.sequence.load();
        let whole = self.magic.load() == MAGIC && self.checksum.load() == checksum(sequence, &words);
        let settings = Settings::from_values(words.map(f32::from_bits));
        (whole && settings.validate().is_ok()).then_some((sequence, settings))
    }

    /// Writes it; valid only after the last store.
    fn write(&self, sequence: u32, settings: &Settings) {
        self.magic.store(0);
        let words = settings.values().map(f32::to_bits);
        self.sequence.store(sequence);
        self.settings.iter().zip(words).for_each(|(cell, word)| cell.store(word));
        self.checksum.store(checksum(sequence, &words));
        self.magic.store(MAGIC);
    }

    fn clear(&self) {
        self.magic.store(0);
    }
}

fn checksum(sequence: u32, words: &[u32; COUNT]) -> u32 {
    let mut digest = CRC_32.digest();
    digest.update(&sequence.to_le_bytes());
    for word in words {
        digest.update(&word.to_le_bytes());
    }
    digest.finalize()
}

/// The memory of the prescription. With any content, [`Prescription::attach`] makes it usable. Fulfils: kept-settings.
#[derive(Debug)]
#[repr(C)]
pub struct PrescriptionMemory {
    copies: [Copy; 2],
    /// Times resumed without a completed breath since, and the complement of that number.
    resumes: Word,
    /// When the device last ventilated.
    notes: Notes,
}

/// Place, sequence number and settings of a valid copy.
type Found = (usize, u32, Settings);

impl PrescriptionMemory {
    /// Memory filled with zeros.
    pub const fn new() -> Self {
        Self { copies: [const { Copy::new() }; 2], resumes: Word::new(), notes: Notes::new() }
    }

    /// Notes the time at which the device ventilates. Call it about once a second while it does, and only then.
    pub fn ventilates_at(&self, now: ClockTime) {
        self.notes.write(now);
    }

    /// The copy with which ventilation is to resume, `away_s` seconds after the last breath, if that is known; none if no
    /// ventilation was interrupted.
    ///
    /// # Errors
    /// Why an interrupted ventilation does not resume.
    fn due(
        &self,
        interruption: Option<Interruption>,
        away_s: Option<u32>,
    ) -> Result<Option<Found>, ChipEvent> {
        let Some(interruption) = interruption else { return Ok(None) };
        let Some(found) = self.newest() else {
            // The end of ventilation clears every magic word, and other content of the memory has none.
            let damaged = self.copies.iter().any(|copy| copy.magic.load() == MAGIC);
            return if damaged { Err(ChipEvent::PrescriptionDamaged) } else { Ok(None) };
        };
        match (interruption, away_s) {
            (_, Some(LONGER_ABSENCE_S..)) => Err(ChipEvent::AbsentTooLong),
            (Interruption::PowerCut, None) => Err(ChipEvent::AbsenceUnknown),
            (Interruption::Program, _) if self.resumes() >= RESUMES => Err(ChipEvent::ResumedTooOften),
            _ => Ok(Some(found)),
        }
    }

    /// The later of the valid copies.
    fn newest(&self) -> Option<Found> {
        let [first, second] = self.copies.each_ref().map(Copy::read);
        match (first, second) {
            (Some((before, _)), Some((after, settings))) if after.wrapping_sub(before) as i32 > 0 => {
                Some((1, after, settings))
            }
            (Some((sequence, settings)), _) => Some((0, sequence, settings)),
            (None, Some((sequence, settings))) => Some((1, sequence, settings)),
            (None, None) => None,
        }
    }

    /// Times resumed; a damaged number counts as none, since it does not tell that the program fails.
    fn resumes(&self) -> u16 {
        let word = self.resumes.load();
        if word as u16 == !(word >> 16) as u16 { word as u16 } else { 0 }
    }

    fn set_resumes(&self, times: u16) {
        self.resumes.store(u32::from(times) | u32::from(!times) << 16);
    }
}

impl Default for PrescriptionMemory {
    fn default() -> Self {
        Self::new()
    }
}

/// Writer of a [`PrescriptionMemory`], and what it held at the start; there must be only one.
#[derive(Debug)]
pub struct Prescription<'a> {
    memory: &'a PrescriptionMemory,
    /// Settings with which ventilation is to resume.
    due: Option<Settings>,
    /// Why an interrupted ventilation does not resume.
    refused: Option<ChipEvent>,
    /// Time that the resumption may still wait for a sound supply, us.
    patience_us: u32,
    /// Whether a failure of the program interrupted it.
    failed: bool,
    /// Settings in the newest copy.
    kept: Option<Settings>,
    /// Place and sequence number of the next copy.
    place: usize,
    sequence: u32,
}

impl<'a> Prescription<'a> {
    /// Attaches to memory with any content, as its first user since the device started. `now`: the time of a clock that has
    /// run since the last note, if there is one.
    pub fn attach(
        memory: &'a PrescriptionMemory,
        interruption: Option<Interruption>,
        now: Option<ClockTime>,
    ) -> Self {
        let away_s = memory.notes.absence_s(now);
        let found = memory.due(interruption, away_s);
        let (refused, found) = (found.err(), found.ok().flatten());
        let (place, sequence) =
            found.map_or((0, 0), |(place, sequence, _)| (1 - place, sequence.wrapping_add(1)));
        let due = found.map(|(_, _, settings)| settings);
        let failed = interruption == Some(Interruption::Program);
        let patience_us = LONGEST_ABSENCE_S.saturating_sub(away_s.unwrap_or(0)) * 1_000_000;
        let mut prescription = Self { memory, due, refused, patience_us, failed, kept: due, place, sequence };
        if due.is_none() {
            prescription.clear();
        }
        prescription
    }

    /// Why the ventilation that the reset has interrupted does not resume; none if it does or if there was none.
    pub fn refused(&self) -> Option<ChipEvent> {
        self.refused
    }

    /// Whether the reset has interrupted a ventilation.
    pub fn is_interrupted(&self) -> bool {
        self.due.is_some() || self.refused.is_some()
    }

    /// Whether ventilation is to resume.
    pub fn is_due(&self) -> bool {
        self.due.is_some()
    }

    /// Resumes ventilation if it is due and the supply is sound; call it in every tick in which it is due. Returns the reason
    /// once the supply has stayed low for too long. Fulfils: resume.
    #[cold]
    pub fn resume(&mut self, control: &mut Control, supply_is_sound: bool) -> Option<ChipEvent> {
        let settings = self.due?;
        if !supply_is_sound {
            let Some(left) = self.patience_us.checked_sub(control.period_us()) else {
                self.clear();
                return Some(ChipEvent::AbsentTooLong);
            };
            self.patience_us = left;
            return None;
        }
        self.due = None;
        if self.failed {
            self.memory.set_resumes(self.memory.resumes().saturating_add(1));
        }
        // Validated settings are refused by no control period of this device; if they are, it stays in standby.
        let _ = control.resume(&settings);
        None
    }

    /// Lets the control half execute a request of a host in this role. Who stops a device that waits to resume ends the wait; no
    /// check moves its valves meanwhile, and its status says so.
    pub fn execute(
        &mut self,
        control: &mut Control,
        request: &ControlRequest,
        role: HostRole,
    ) -> ControlReply {
        match request {
            ControlRequest::Stop if self.is_due() => self.clear(),
            ControlRequest::SelfTest(Some(_)) if self.is_due() => {
                return ControlReply::Response(Response::Refused(Refusal::Ventilating));
            }
            _ => {}
        }
        let mut reply = control.execute_for(request, role);
        if let ControlReply::Status(status) = &mut reply {
            status.resumes = self.is_due();
        }
        reply
    }

    /// What may be done to the flash: nothing either while ventilation waits to resume.
    #[inline]
    pub fn leave(&self, control: &Control) -> Leave {
        if self.is_due() { Leave::Nothing } else { control.leave() }
    }

    /// Keeps the settings of a breath in its second tick, since the first takes longest of all, and clears them in the first tick
    /// after ventilation. Call it in every tick before a request is executed: a stop is then kept before a restart. Fulfils: first-start.
    #[inline]
    pub fn keep(&mut self, control: &Control, output: &Output) {
        debug_assert!(self.due.is_none() || self.due == self.kept, "what is due is kept");
        debug_assert!(self.due.is_none() || self.refused.is_none());
        match (&output.sample, output.mode) {
            (Some(sample), _) if sample.tick == 1 => self.breath_has_begun(control, sample.breath),
            // Who starts it does not wait for it to resume. A start without a reading yet has no sample, and ends nothing.
            (_, Mode::Ventilating) => self.due = None,
            // It waits.
            (_, Mode::Standby) if self.due.is_some() => {}
            _ if self.kept.is_some() => self.clear(),
            _ => {}
        }
    }

    fn breath_has_begun(&mut self, control: &Control, number: u32) {
        if number == 1 {
            self.memory.set_resumes(0);
        }
        if self.kept.is_none() {
            // A note that the link task has begun before the end of an earlier ventilation.
            self.memory.notes.clear();
        }
        let settings = control.prescription();
        if let Some(settings) = settings.filter(|_| settings != self.kept) {
            self.memory.copies[self.place % 2].write(self.sequence, &settings);
            (self.place, self.sequence) = (1 - self.place % 2, self.sequence.wrapping_add(1));
            self.kept = Some(settings);
        }
    }

    /// Clears both copies, the older one first: a reset in between leaves the newer one, not the older.
    #[cold]
    fn clear(&mut self) {
        (self.due, self.kept) = (None, None);
        self.memory.copies[self.place % 2].clear();
        self.memory.copies[1 - self.place % 2].clear();
        self.memory.set_resumes(0);
        self.memory.notes.clear();
    }
}

#[cfg(test)]
mod tests;
