//! Memory of closed loops, in which shards take turns.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// As many tapes as shards run at once: these few stay in the caches, where one for each shard would not.
#[derive(Debug)]
pub(super) struct Tapes<T>(Mutex<Vec<T>>);

impl<T> Tapes<T> {
    /// No tape yet.
    pub fn new() -> Self {
        Self(Mutex::default())
    }

    /// Runs a shard on a tape that no other one is on; makes it if there is none.
    pub fn lend<R>(&self, make: impl FnOnce() -> T, run: impl FnOnce(&mut T) -> R) -> R {
        let returned = self.returned().pop();
        let mut tape = returned.unwrap_or_else(make);
        let result = run(&mut tape);
        self.returned().push(tape);
        result
    }

    fn returned(&self) -> MutexGuard<'_, Vec<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
