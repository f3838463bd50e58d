//! Keeps the recording of an ended ventilation in flash, for the case that the supply fails.
//!
//! [`Keeper::step`] is called regularly by a task of low priority. When ventilation has ended and the last ticks are recorded,
//! it copies the recorder's memory piece by piece, once per end of a ventilation; then it has the older copy erased, so that
//! the next one needs no erase before it. [`Leave`] says what the control task allows: nothing is written while the device
//! ventilates, and an erase, which stalls the chip for seconds, waits until nothing can start ventilation meanwhile. A start
//! ends a running copy; the older one stays, and the end of that ventilation is copied instead.

use embedded_storage::nor_flash::NorFlash;

use super::RecorderMemory;
use super::copy::{END, WORDS};
use crate::flash::archive::Archive;
use crate::reset::ResetCause;

/// What may be done to the flash now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Leave {
    /// Nothing: the device ventilates, is about to, or moves its valves.
    Nothing,
    /// Writing, which stalls the core for less than a millisecond at a time.
    Write,
    /// Erasing too, which stalls it for seconds: only a request starts ventilation.
    Erase,
}

impl Leave {
    /// The leave with this number, as `leave as u8` numbers them; nothing for any other.
    pub fn of(number: u8) -> Self {
        [Self::Write, Self::Erase].into_iter().find(|leave| *leave as u8 == number).unwrap_or(Self::Nothing)
    }
}

/// Keeps copies of a recorder's memory in two slots of flash.
#[derive(Debug)]
pub struct Keeper {
    archive: Archive<WORDS>,
    /// End of the recording that is in flash, or whose copy has failed.
    kept: Option<[u32; 2]>,
    /// End of the recording whose copy runs, or for which a slot is erased.
    pending: Option<[u32; 2]>,
    /// Whether the copy before the newest is to be erased.
    superseded: bool,
    /// Number of ticks recorded at the last step.
    recorded: u32,
}

impl Keeper {
    /// Length of a slot, bytes.
    pub const BYTES: u32 = Archive::<WORDS>::BYTES;

    /// Finds the copies in slots at these addresses of the flash. If the memory has lost its content, it gets that of the newest
    /// copy; returns whether it has. To be called before [`super::Recorder::attach`].
    pub fn attach<F: NorFlash>(
        flash: &mut F,
        starts: [u32; 2],
        memory: &RecorderMemory,
        cause: ResetCause,
    ) -> (Self, bool) {
        let archive = Archive::open(flash, starts);
        let lost = cause == ResetCause::PowerOn || !memory.is_sound();
        let restored = lost && memory.restore(|index| archive.word(flash, index));
        let end = END.map(|index| archive.word(flash, index));
        let kept = if let [Some(recording), Some(tick)] = end { Some([recording, tick]) } else { None };
        (Self { archive, kept, pending: None, superseded: false, recorded: 0 }, restored)
    }

    /// Does the next piece of work, with at least a control tick since the last call. Returns true if [`Keeper::erase`] is to
    /// be called, by a caller who has prepared for a stall of the core.
    #[must_use]
    pub fn step<F: NorFlash>(&mut self, flash: &mut F, memory: &RecorderMemory, leave: Leave) -> bool {
        let end = memory.end();
        let recorded = memory.fast.next();
        let settled = core::mem::replace(&mut self.recorded, recorded) == recorded;
        if self.archive.is_running() && end != self.pending {
            self.archive.abandon();
        }
        if leave == Leave::Nothing {
            return false;
        }
        if self.archive.is_running() {
            debug_assert!(end.is_some() && end == self.pending);
            match self.archive.step(flash, |index| memory.word(index)) {
                Ok(false) => {}
                Ok(true) => (self.kept, self.superseded) = (self.pending, true),
                Err(_) => self.kept = self.pending,
            }
            return false;
        }
        let due = settled && end.is_some() && end != self.kept;
        if due {
            self.pending = end;
        }
        if self.archive.is_erased() {
            if due {
                self.archive.begin();
            }
            return false;
        }
        (due || self.superseded) && leave == Leave::Erase
    }

    /// Erases the slot of the next copy, which stalls the core for seconds.
    pub fn erase<F: NorFlash>(&mut self, flash: &mut F) {
        debug_assert!(!self.archive.is_running(), "no copy is erased while it is written");
        self.superseded = false;
        if self.archive.erase(flash).is_err() {
            // Once per end of a ventilation: a worn flash must not stall the chip again and again.
            self.kept = self.pending;
        }
    }
}

#[cfg(test)]
mod tests;
