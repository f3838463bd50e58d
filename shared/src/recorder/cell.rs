//! Words of memory that an interrupt may write while another task reads, and that a reset may leave at any store.
//!
//! Atomics, because any bit pattern is a valid one and their order can be told; a core with one bus needs no more.

use core::sync::atomic::{AtomicU16, AtomicU32, Ordering};

/// 32 bits.
#[derive(Debug)]
#[repr(transparent)]
pub(super) struct Word(AtomicU32);

/// 16 bits.
#[derive(Debug)]
#[repr(transparent)]
pub(super) struct Half(AtomicU16);

impl Word {
    pub(super) const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    pub(super) fn load(&self) -> u32 {
        self.0.load(Ordering::Acquire)
    }

    /// Stores after everything that was stored before.
    pub(super) fn store(&self, value: u32) {
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

    /// Stores in any order with other halves, but before the next [`Word::store`].
    pub(super) fn store(&self, value: u16) {
        if fuse::holds() {
            self.0.store(value, Ordering::Relaxed);
        }
    }
}

/// Whether the supply still holds.
#[cfg(not(test))]
mod fuse {
    pub(super) const fn holds() -> bool {
        true
    }
}

/// In tests the supply can be cut after any number of stores: those that follow never reach the memory.
#[cfg(test)]
pub(super) mod fuse {
    use core::cell::Cell;

    std::thread_local! {
        static LEFT: Cell<usize> = const { Cell::new(usize::MAX) };
    }

    /// Lets this many stores through.
    pub fn set(stores: usize) {
        LEFT.set(stores);
    }

    /// Stores that would still get through.
    pub fn left() -> usize {
        LEFT.get()
    }

    pub(super) fn holds() -> bool {
        let left = LEFT.get();
        LEFT.set(left.saturating_sub(1));
        left > 0
    }
}
