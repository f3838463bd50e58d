//! Progress bars for work that goes through steps: one bar at a time, made anew when the step changes.

use std::sync::{Mutex, PoisonError};

use indicatif::ProgressBar;

use super::common::bar;

/// The bar of the step under way.
#[derive(Debug, Default)]
pub struct StageBars {
    current: Mutex<Option<(String, ProgressBar)>>,
}

impl StageBars {
    /// Shows `done` of `total` of the step called `name`.
    pub fn show(&self, name: &str, done: usize, total: usize) {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        if current.as_ref().is_none_or(|(shown, _)| shown != name) {
            if let Some((_, finished)) = current.take() {
                finished.finish();
            }
            *current = Some((name.to_owned(), bar(name, total)));
        }
        if let Some((_, bar)) = &*current {
            bar.set_length(total as u64);
            // Steps run in parallel report out of order.
            bar.set_position(bar.position().max(done as u64));
        }
    }

    /// Ends the last bar.
    pub fn finish(&self) {
        if let Some((_, bar)) = self.current.lock().unwrap_or_else(PoisonError::into_inner).take() {
            bar.finish();
        }
    }
}
