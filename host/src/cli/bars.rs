//! Progress bars on standard error, one for each stage in progress; hidden if standard error is not a terminal.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use super::common::stop;
use super::embedded;
use progress::{Event, Progress, Stage};

/// Runs work with progress bars and Ctrl-C handling. If another program has called the command, that one receives the progress.
pub fn with_bars<T>(work: impl FnOnce(&Progress<'_>) -> T) -> T {
    if let Some(observer) = embedded::observer() {
        return work(&Progress::new(&*observer, stop()));
    }
    let bars = Bars::default();
    let show = |event: &Event<'_>| bars.show(event);
    let outcome = work(&Progress::new(&show, stop()));
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
        let stage = name(event);
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
    let style = ProgressStyle::with_template("{msg:<28} {bar:40} {pos:>6}/{len} {elapsed:>4} left {eta}");
    let bar = ProgressBar::new(0).with_message(name.to_owned());
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.enable_steady_tick(Duration::from_millis(250));
    bar
}

/// The label of a stage, with its subject and round.
pub fn name(event: &Event<'_>) -> String {
    let stage = match event.stage {
        Stage::TunePid => "search PID, breaths",
        Stage::TuneRival => "search rival, plants",
        Stage::Collect => "collect breaths",
        Stage::Units => "record and fit units",
        Stage::Fit => "fit simulators",
        Stage::Train => "train controller",
        Stage::Reinforce => "train by rewards",
        Stage::Evaluate => "score waveforms",
        Stage::Bound => "search reference bound",
        Stage::Faults => "inject faults",
        Stage::Torture => "torture, breaths",
        Stage::Endure => "endure, minutes",
        Stage::Robust => "plants",
        Stage::Sweep => "run the sweep",
        Stage::Pieces => "run experiments",
        Stage::Shards => "run shards",
        Stage::Margins => "measure loops",
        Stage::Accuracy => "measure accuracy, plants",
        Stage::Upload => "send weights, bytes",
        Stage::ReadRecorder => "read flight recorder",
        Stage::Import => "read tables, bytes",
    };
    let subject = if event.subject.is_empty() { String::new() } else { format!("{}: ", event.subject) };
    let round = event.round.map_or_else(String::new, |round| format!("round {}: ", round + 1));
    format!("{subject}{round}{stage}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_names_subject_round_and_stage() {
        let alone = Event { subject: "", round: None, stage: Stage::Collect, done: 0, total: 1 };
        assert_eq!(name(&alone), "collect breaths");
        let event = Event { subject: "lungs/R5C10-0", round: Some(1), stage: Stage::Fit, ..alone };
        assert_eq!(name(&event), "lungs/R5C10-0: round 2: fit simulators");
    }

    /// Position and length of a subject's bar; `None` once it is full.
    fn position(bars: &Bars, subject: &str) -> Option<(u64, Option<u64>)> {
        let subjects = bars.subjects.lock().unwrap();
        subjects.get(subject)?.bar.as_ref().map(|bar| (bar.position(), bar.length()))
    }

    #[test]
    fn a_bar_never_goes_back_and_a_stage_that_changes_gets_a_new_one() {
        let bars = Bars::default();
        let event = Event { subject: "", round: None, stage: Stage::Collect, done: 3, total: 9 };
        bars.show(&event);
        bars.show(&Event { done: 2, ..event });
        assert_eq!(position(&bars, ""), Some((3, Some(9))));
        bars.show(&Event { stage: Stage::Fit, done: 1, ..event });
        assert_eq!(position(&bars, ""), Some((1, Some(9))));
        bars.finish();
        assert_eq!(position(&bars, ""), None);
    }

    #[test]
    fn subjects_side_by_side_keep_their_bars_until_these_are_full() {
        let bars = Bars::default();
        let event = Event { subject: "R5C10", round: None, stage: Stage::Fit, done: 1, total: 4 };
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
