//! Memory cells that an interrupt may write while another task reads, and whose writing a reset may interrupt at any store.
//!
//! They are atomics: every bit pattern is valid, and the order of stores is defined; a single-core chip needs no more.

use core::sync::atomic::{AtomicU16, AtomicU32, Ordering};

/// A cell of 32 bits.
#[derive(Debug)]
#[repr(transparent)]
pub(crate) struct Word(AtomicU32);

/// A cell of 16 bits.
#[derive(Debug)]
#[repr(transparent)]
pub(super) struct Half(AtomicU16);

impl Word {
    pub(crate) const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    pub(crate) fn load(&self) -> u32 {
        self.0.load(Ordering::Acquire)
    }

    /// Stores `value` after all earlier stores.
    pub(crate) fn store(&self, value: u32) {
        if fuse::holds() {
            self.0.store(value, Ordering::Release);
        }
    }
}

impl Half {
    pub(super) const fn new() -> Self {
        Self(AtomicU16::new(0))
    }

    pub(super) fn load(&self) -> u16 {
        self.0.load(Ordering::Relaxed)
    }

    /// Stores `value` in any order relative to other halves, but before the next [`Word::store`].
    pub(super) fn store(&self, value: u16) {
        if fuse::holds() {
            self.0.store(value, Ordering::Relaxed);
        }
    }
}

/// Simulation of the supply for tests; here it never fails.
#[cfg(not(test))]
mod fuse {
    pub(super) const fn holds() -> bool {
        true
    }
}

/// In tests the supply can fail after any number of stores; later stores do not reach the memory.
#[cfg(test)]
pub(crate) mod fuse {
    use core::cell::Cell;

    std::thread_local! {
        static LEFT: Cell<usize> = const { Cell::new(usize::MAX) };
    }

    /// Lets the supply fail after this many stores.
    pub fn set(stores: usize) {
        LEFT.set(stores);
    }

    /// Stores left until the supply fails.
    pub fn left() -> usize {
        LEFT.get()
    }

    pub(super) fn holds() -> bool {
        let left = LEFT.get();
        LEFT.set(left.saturating_sub(1));
        left > 0
    }
}
