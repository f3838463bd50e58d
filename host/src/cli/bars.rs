//! Progress bars on standard error, one for each stage in progress; hidden if standard error is not a terminal.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use super::common::stop;
use progress::{Event, Progress, Stage};

/// Runs work with progress bars and Ctrl-C handling.
pub fn with_bars<T>(work: impl FnOnce(&Progress<'_>) -> T) -> T {
    let bars = Bars::default();
    let show = |event: &Event<'_>| bars.show(event);
    let outcome = work(&Progress::new(&show, stop()));
    bars.finish();
    outcome
}

/// The bar of the current stage.
#[derive(Debug, Default)]
struct Bars {
    current: Mutex<Option<(String, ProgressBar)>>,
}

impl Bars {
    fn show(&self, event: &Event<'_>) {
        let name = name(event);
        if event.done > 0 {
            tracing::debug!(done = event.done, total = event.total, "{name}");
        }
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        if current.as_ref().is_none_or(|(shown, _)| *shown != name) {
            if let Some((_, finished)) = current.take() {
                finished.finish();
            }
            *current = Some((name.clone(), bar(&name)));
        }
        if let Some((_, bar)) = &*current {
            bar.set_length(event.total as u64);
            // Parts that run in parallel report out of order.
            bar.set_position(bar.position().max(event.done as u64));
        }
    }

    /// Leaves the last bar at its position: a stopped stage is not full.
    fn finish(&self) {
        if let Some((_, bar)) = self.current.lock().unwrap_or_else(PoisonError::into_inner).take() {
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
fn name(event: &Event<'_>) -> String {
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

    #[test]
    fn a_bar_never_goes_back_and_a_stage_that_changes_gets_a_new_one() {
        let bars = Bars::default();
        let event = Event { subject: "", round: None, stage: Stage::Collect, done: 3, total: 9 };
        let position =
            || bars.current.lock().unwrap().as_ref().map(|(_, bar)| (bar.position(), bar.length()));
        bars.show(&event);
        bars.show(&Event { done: 2, ..event });
        assert_eq!(position(), Some((3, Some(9))));
        bars.show(&Event { stage: Stage::Fit, done: 1, ..event });
        assert_eq!(position(), Some((1, Some(9))));
        bars.finish();
        assert_eq!(position(), None);
    }
}
