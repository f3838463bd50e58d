//! The recorder's memory as words, for a copy in flash that is made while the writer goes on.
//!
//! After the words of the memory follows the number of the oldest entry of each ring at the end of the copy: entries before it
//! were overwritten while they were copied.

use super::cell::Word;
use super::entry::{EVENT_HALVES, TICK_HALVES};
use super::ring::Ring;
use super::{FAST_ENTRIES, LOG_ENTRIES, RecorderMemory, RecordingState, SLOW_ENTRIES};

/// Words of the memory before the rings.
const HEADER: usize = 6;
const FAST: usize = Ring::<{ FAST_ENTRIES + 1 }, TICK_HALVES>::WORDS;
const SLOW: usize = Ring::<{ SLOW_ENTRIES + 1 }, TICK_HALVES>::WORDS;
const LOG: usize = Ring::<{ LOG_ENTRIES + 1 }, EVENT_HALVES>::WORDS;
/// Number of words of the memory.
const MEMORY: usize = HEADER + FAST + SLOW + LOG;
/// Places of the numbers of the oldest entries.
const OLDEST_FAST: usize = MEMORY;
const OLDEST_SLOW: usize = MEMORY + 1;
const OLDEST_LOG: usize = MEMORY + 2;
/// Number of words of a copy.
pub(super) const WORDS: usize = MEMORY + 3;

/// Words that tell one end of a recording from another: see [`RecorderMemory::end`].
pub(super) const END: [usize; 2] = [3, 4];

const _: () = assert!(4 * MEMORY == size_of::<RecorderMemory>());

impl RecorderMemory {
    /// A word of a copy.
    pub(super) fn word(&self, index: usize) -> u32 {
        let Self { fast, slow, log, .. } = self;
        match index {
            ..HEADER => self.header(index).load(),
            OLDEST_FAST => fast.held().first,
            OLDEST_SLOW => slow.held().first,
            OLDEST_LOG.. => log.held().first,
            _ => self.rings(index - HEADER, |ring, index| ring.load(index)),
        }
    }

    /// Replaces the content by that of a copy, if it gives all words and they are those of a recorder with this layout. The
    /// content is valid only after the last store.
    pub(super) fn restore(&self, mut copy: impl FnMut(usize) -> Option<u32>) -> bool {
        self.magic.store(0);
        for index in 1..MEMORY {
            let Some(word) = copy(index) else { return false };
            match index {
                ..HEADER => self.header(index).store(word),
                _ => self.rings(index - HEADER, |ring, index| ring.store(index, word)),
            }
        }
        let oldest = [OLDEST_FAST, OLDEST_SLOW, OLDEST_LOG].map(&mut copy);
        let ([Some(first_fast), Some(first_slow), Some(first_log)], Some(magic)) = (oldest, copy(0)) else {
            return false;
        };
        let Self { fast, slow, log, .. } = self;
        fast.remove_before(first_fast);
        slow.remove_before(first_slow);
        log.remove_before(first_log);
        self.magic.store(magic);
        self.is_sound()
    }

    fn header(&self, index: usize) -> &Word {
        match index {
            0 => &self.magic,
            1 => &self.layout,
            2 => &self.boots,
            3 => &self.recording,
            4 => &self.tick,
            _ => &self.clear,
        }
    }

    /// Accesses a word of the rings.
    fn rings<T>(&self, index: usize, access: impl FnOnce(&dyn Words, usize) -> T) -> T {
        let Self { fast, slow, log, .. } = self;
        if index < FAST {
            access(fast, index)
        } else if index < FAST + SLOW {
            access(slow, index - FAST)
        } else {
            access(log, index - FAST - SLOW)
        }
    }

    /// The end of the recording, if it has ended: two words that no other end has.
    pub(super) fn end(&self) -> Option<[u32; 2]> {
        match self.recording()?.0 {
            RecordingState::Nothing | RecordingState::Running => None,
            RecordingState::Stopped | RecordingState::Fault(_) | RecordingState::Reset => {
                Some(END.map(|index| self.header(index).load()))
            }
        }
    }
}

/// A ring as words.
trait Words {
    fn load(&self, index: usize) -> u32;
    fn store(&self, index: usize, word: u32);
}

impl<const SLOTS: usize, const HALVES: usize> Words for Ring<SLOTS, HALVES> {
    fn load(&self, index: usize) -> u32 {
        self.word(index)
    }

    fn store(&self, index: usize, word: u32) {
        self.set_word(index, word);
    }
}
