//! A ring buffer of entries that stays valid through a reset at any store.
//!
//! An entry is written to a slot that is not visible, then a store of one word makes it visible. So one slot is always
//! invisible, and after a reset the new entry is either complete or absent.

use heapless::Vec;

use super::cell::{Half, Word};
use super::{Held, PAGE_BYTES};

/// Attempts of a reader that the writer overtakes: the writer runs once per millisecond, and reading takes far less.
const ATTEMPTS: usize = 3;

/// The ring buffer. Entries are numbered; the number determines the slot.
#[derive(Debug)]
#[repr(C)]
pub(super) struct Ring<const SLOTS: usize, const HALVES: usize> {
    /// Number of the next entry.
    next: Word,
    /// Number of the first entry since the ring was cleared.
    start: Word,
    /// See [`Held::origin`].
    origin: Word,
    slots: [[Half; HALVES]; SLOTS],
}

impl<const SLOTS: usize, const HALVES: usize> Ring<SLOTS, HALVES> {
    /// Largest number of visible entries.
    pub(super) const VISIBLE: u32 = SLOTS as u32 - 1;
    /// At this number the numbering continues from `SLOTS`; both numbers are in the first slot.
    pub(super) const LIMIT: u32 = (1 << 30) / (SLOTS as u32) * (SLOTS as u32);

    pub(super) const fn new() -> Self {
        let slots = [const { [const { Half::new() }; HALVES] }; SLOTS];
        Self { next: Word::new(), start: Word::new(), origin: Word::new(), slots }
    }

    /// Whether the state is possible.
    pub(super) fn is_sound(&self) -> bool {
        let next = self.next.load();
        next < Self::LIMIT && self.start.load() <= next
    }

    /// Formats any memory as an empty ring. No reader may access it meanwhile.
    pub(super) fn format(&self) {
        self.next.store(0);
        self.start.store(0);
        self.origin.store(0);
    }

    /// Removes all entries.
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

    /// Words of the state and the slots.
    pub(super) const WORDS: usize = 3 + (SLOTS * HALVES).div_ceil(2);

    /// A word of the ring's memory: the state, then the slots.
    pub(super) fn word(&self, index: usize) -> u32 {
        let half = |half: usize| self.half(half).map_or(0, |half| u32::from(half.load()));
        match index.checked_sub(3) {
            Some(pair) => half(2 * pair) | half(2 * pair + 1) << 16,
            None => self.state(index).load(),
        }
    }

    /// Sets a word of the ring's memory.
    pub(super) fn set_word(&self, index: usize, word: u32) {
        match index.checked_sub(3) {
            Some(pair) => {
                let halves = [(2 * pair, word as u16), (2 * pair + 1, (word >> 16) as u16)];
                for (half, value) in halves {
                    if let Some(half) = self.half(half) {
                        half.store(value);
                    }
                }
            }
            None => self.state(index).store(word),
        }
    }

    fn state(&self, index: usize) -> &Word {
        match index {
            0 => &self.next,
            1 => &self.start,
            _ => &self.origin,
        }
    }

    fn half(&self, index: usize) -> Option<&Half> {
        self.slots.get(index / HALVES)?.get(index % HALVES)
    }

    /// Removes the entries before this number.
    pub(super) fn remove_before(&self, first: u32) {
        self.start.store(first.max(self.start.load()).min(self.next.load()));
    }

    /// Adds an entry. `stride` is the number of ticks per entry.
    #[inline]
    pub(super) fn push(&self, entry: [u16; HALVES], stride: u32) {
        let next = self.next.load();
        if let Some(slot) = self.slots.get(next as usize % SLOTS) {
            for (half, value) in slot.iter().zip(entry) {
                half.store(value);
            }
        }
        debug_assert!(self.is_sound(), "formatted before the first entry");
        if next + 1 < Self::LIMIT {
            self.next.store(next + 1);
        } else {
            self.begin_again(stride);
        }
    }

    /// Reduces the numbers of all entries, so that they never overflow: at most once in 12 days.
    #[cold]
    fn begin_again(&self, stride: u32) {
        let step = Self::LIMIT - SLOTS as u32;
        self.start.store(self.start.load().saturating_sub(step));
        self.origin.store(self.origin.load().wrapping_add(stride.wrapping_mul(step)));
        self.next.store(SLOTS as u32);
        debug_assert!(self.is_sound(), "entries keep their order");
    }

    /// The visible entries.
    pub(super) fn held(&self) -> Held {
        let next = self.next.load();
        let first = self.start.load().max(next.saturating_sub(Self::VISIBLE)).min(next);
        Held { first, next, origin: self.origin.load() }
    }

    /// Reads as many entries as fit into a page, from this number or the oldest one on; returns the number of the first.
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
                // A page has room for `count` entries.
                let _ = bytes.extend_from_slice(&half.load().to_le_bytes());
            }
        }
        bytes
    }

    /// For tests: continues at another number.
    #[cfg(test)]
    pub(super) fn jump(&self, next: u32) {
        self.next.store(next);
        self.start.store(next);
    }

    /// For tests: overwrites the state.
    #[cfg(test)]
    pub(super) fn spoil(&self, words: [u32; 3]) {
        for (word, value) in [&self.next, &self.start, &self.origin].into_iter().zip(words) {
            word.store(value);
        }
    }
}
