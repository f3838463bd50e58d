//! How long work reports progress and learns that it should stop.

use std::sync::atomic::{AtomicBool, Ordering};

/// Receives progress (done, total) and carries the wish to stop.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    progress: &'a (dyn Fn(u64, u64) + Sync),
    stop: &'a AtomicBool,
}

static NEVER: AtomicBool = AtomicBool::new(false);

impl<'a> Watch<'a> {
    /// Reports to `progress`; stops at the next good moment once `stop` is set.
    pub fn new(progress: &'a (dyn Fn(u64, u64) + Sync), stop: &'a AtomicBool) -> Self {
        Self { progress, stop }
    }

    /// Reports to nobody and never stops.
    pub fn silent() -> Watch<'static> {
        Watch { progress: &|_, _| (), stop: &NEVER }
    }

    /// Reports that `done` of `total` steps are done.
    pub fn progress(&self, done: usize, total: usize) {
        (self.progress)(done as u64, total as u64);
    }

    /// Whether to stop.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The flag itself.
    pub fn stop(&self) -> &AtomicBool {
        self.stop
    }
}
