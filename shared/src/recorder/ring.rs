//! A ring of entries in memory that survives a reset at any store.
//!
//! An entry is written to a slot that nobody sees, then one word makes it visible. So one slot fewer can be seen than there
//! are, and a reset leaves either the entries with the new one or those without it.

use heapless::Vec;

use super::cell::{Half, Word};
use super::{Held, PAGE_BYTES};

/// Attempts of a reader that the writer overtakes: the writer comes once in a millisecond, reading takes far less.
const ATTEMPTS: usize = 3;

/// The ring. Entries are numbered; the number of an entry gives its slot.
#[derive(Debug)]
#[repr(C)]
pub(super) struct Ring<const SLOTS: usize, const HALVES: usize> {
    /// Number of the next entry.
    next: Word,
    /// Number of the first entry since the ring was emptied.
    start: Word,
    /// Added to an entry's number (times the entries' distance) gives its tick, see [`Held::origin`].
    origin: Word,
    slots: [[Half; HALVES]; SLOTS],
}

impl<const SLOTS: usize, const HALVES: usize> Ring<SLOTS, HALVES> {
    /// Entries that can be seen at most.
    pub(super) const VISIBLE: u32 = SLOTS as u32 - 1;
    /// Numbers begin again at `SLOTS` after this one; both lie in the first slot.
    pub(super) const LIMIT: u32 = (1 << 30) / (SLOTS as u32) * (SLOTS as u32);

    pub(super) const fn new() -> Self {
        let slots = [const { [const { Half::new() }; HALVES] }; SLOTS];
        Self { next: Word::new(), start: Word::new(), origin: Word::new(), slots }
    }

    /// Whether this can be a ring's state.
    pub(super) fn is_sound(&self) -> bool {
        let next = self.next.load();
        next < Self::LIMIT && self.start.load() <= next
    }

    /// Makes any memory an empty ring. Nobody may read it in between.
    pub(super) fn format(&self) {
        self.next.store(0);
        self.start.store(0);
        self.origin.store(0);
    }

    /// Forgets all entries.
    pub(super) fn empty(&self) {
        self.start.store(self.next.load());
    }

    /// Number of the next entry.
    pub(super) fn next(&self) -> u32 {
        self.next.load()
    }

    /// See [`Held::origin`].
    pub(super) fn set_origin(&self, origin: u32) {
        self.origin.store(origin);
    }

    /// Adds an entry. `stride` is the distance of entries in ticks.
    #[inline]
    pub(super) fn push(&self, entry: [u16; HALVES], stride: u32) {
        let next = self.next.load();
        if let Some(slot) = self.slots.get(next as usize % SLOTS) {
            for (half, value) in slot.iter().zip(entry) {
                half.store(value);
            }
        }
        if next + 1 < Self::LIMIT {
            self.next.store(next + 1);
        } else {
            self.begin_again(stride);
        }
    }

    /// Numbers the entries from the first slot's lowest number on, so that the number never overflows: once in twelve days.
    #[cold]
    fn begin_again(&self, stride: u32) {
        let step = Self::LIMIT - SLOTS as u32;
        self.start.store(self.start.load().saturating_sub(step));
        self.origin.store(self.origin.load().wrapping_add(stride.wrapping_mul(step)));
        self.next.store(SLOTS as u32);
    }

    /// The visible entries.
    pub(super) fn held(&self) -> Held {
        let next = self.next.load();
        let first = self.start.load().max(next.saturating_sub(Self::VISIBLE)).min(next);
        Held { first, next, origin: self.origin.load() }
    }

    /// As many entries as fit into a page, from this number or the oldest one on; the number of the first.
    pub(super) fn read(&self, from: u32) -> (u32, Vec<u8, PAGE_BYTES>) {
        let mut first = from.max(self.held().first);
        for _ in 0..ATTEMPTS {
            let bytes = self.copy(first);
            let oldest = self.held().first;
            if oldest <= first {
                return (first, bytes);
            }
            first = oldest;
        }
        (first, Vec::new())
    }

    fn copy(&self, first: u32) -> Vec<u8, PAGE_BYTES> {
        let mut bytes = Vec::new();
        let count = PAGE_BYTES / (2 * HALVES);
        for number in (first..self.next.load()).take(count) {
            let Some(slot) = self.slots.get(number as usize % SLOTS) else { continue };
            for half in slot {
                // There is room for so many entries.
                let _ = bytes.extend_from_slice(&half.load().to_le_bytes());
            }
        }
        bytes
    }

    /// For tests: goes on at another number.
    #[cfg(test)]
    pub(super) fn jump(&self, next: u32) {
        self.next.store(next);
        self.start.store(next);
    }

    /// For tests: any bytes in place of the state.
    #[cfg(test)]
    pub(super) fn spoil(&self, words: [u32; 3]) {
        for (word, value) in [&self.next, &self.start, &self.origin].into_iter().zip(words) {
            word.store(value);
        }
    }
}
