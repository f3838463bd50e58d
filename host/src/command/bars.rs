//! Progress bars on standard error, one for each stage in progress; hidden if standard error is not a terminal.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use progress::{Event, Progress};

/// Runs work with progress bars.
pub fn with_bars<T>(stop: &AtomicBool, work: impl FnOnce(&Progress<'_>) -> T) -> T {
    let bars = Bars::default();
    let show = |event: &Event<'_>| bars.show(event);
    let outcome = work(&Progress::new(&show, stop));
    bars.finish();
    outcome
}

/// The bars: one for each subject, because work on several subjects may run side by side.
#[derive(Debug, Default)]
struct Bars {
    drawn: MultiProgress,
    subjects: Mutex<BTreeMap<String, Shown>>,
}

/// The latest stage of a subject.
#[derive(Debug)]
struct Shown {
    stage: String,
    /// Its bar, until it is full: then it stays on the screen, and later bars go below it.
    bar: Option<ProgressBar>,
}

impl Bars {
    fn show(&self, event: &Event<'_>) {
        let stage = event.label();
        if event.done > 0 {
            tracing::debug!(done = event.done, total = event.total, "{stage}");
        }
        let mut subjects = self.subjects.lock().unwrap_or_else(PoisonError::into_inner);
        match subjects.get(event.subject) {
            Some(shown) if shown.stage == stage => {}
            other => {
                if let Some(bar) = other.and_then(|shown| shown.bar.as_ref()) {
                    bar.finish();
                }
                let bar = Some(self.drawn.add(bar(&stage)));
                subjects.insert(event.subject.to_owned(), Shown { stage, bar });
            }
        }
        let Some(shown) = subjects.get_mut(event.subject) else { return };
        if let Some(bar) = &shown.bar {
            bar.set_length(event.total as u64);
            // Parts that run in parallel report out of order.
            bar.set_position(bar.position().max(event.done as u64));
            if event.total > 0 && event.done >= event.total {
                bar.finish();
                shown.bar = None;
            }
        }
    }

    /// Leaves bars that are not full at their position: their stages were stopped.
    fn finish(&self) {
        let subjects = std::mem::take(&mut *self.subjects.lock().unwrap_or_else(PoisonError::into_inner));
        for bar in subjects.into_values().filter_map(|shown| shown.bar) {
            bar.abandon();
        }
    }
}

fn bar(name: &str) -> ProgressBar {
    let style =
        ProgressStyle::with_template("{msg:<28} {wide_bar} {pos}/{len}, {elapsed} so far, {eta} left");
    let bar = ProgressBar::new(0).with_message(name.to_owned());
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.enable_steady_tick(Duration::from_millis(250));
    bar
}

#[cfg(test)]
mod tests {
    use super::*;
    use progress::Stage;

    const COLLECT: Stage = Stage("collect breaths");
    const FIT: Stage = Stage("fit simulators");

    /// Position and length of a subject's bar; `None` once it is full.
    fn position(bars: &Bars, subject: &str) -> Option<(u64, Option<u64>)> {
        let subjects = bars.subjects.lock().unwrap();
        subjects.get(subject)?.bar.as_ref().map(|bar| (bar.position(), bar.length()))
    }

    #[test]
    fn a_bar_never_goes_back_and_a_stage_that_changes_gets_a_new_one() {
        let bars = Bars::default();
        let event = Event { subject: "", round: None, stage: COLLECT, done: 3, total: 9 };
        bars.show(&event);
        bars.show(&Event { done: 2, ..event });
        assert_eq!(position(&bars, ""), Some((3, Some(9))));
        bars.show(&Event { stage: FIT, done: 1, ..event });
        assert_eq!(position(&bars, ""), Some((1, Some(9))));
        bars.finish();
        assert_eq!(position(&bars, ""), None);
    }

    #[test]
    fn subjects_side_by_side_keep_their_bars_until_these_are_full() {
        let bars = Bars::default();
        let event = Event { subject: "R5C10", round: None, stage: FIT, done: 1, total: 4 };
        bars.show(&event);
        bars.show(&Event { subject: "R5C20", done: 2, ..event });
        assert_eq!(position(&bars, "R5C10"), Some((1, Some(4))));
        bars.show(&Event { done: 4, ..event });
        assert_eq!(position(&bars, "R5C10"), None);
        assert_eq!(position(&bars, "R5C20"), Some((2, Some(4))));
        bars.show(&Event { done: 4, ..event });
        assert_eq!(bars.subjects.lock().unwrap().len(), 2, "a full bar is not drawn again");
        assert_eq!(position(&bars, "R5C10"), None);
    }
}
