//! The event log of a flight recorder in words.

use shared::recorder::LogEntry;

use crate::stream::{Log, LogLine};

/// The log for a page, oldest event first; a control tick lasts `period_us` microseconds.
pub fn log(entries: &[LogEntry], period_us: u32) -> Log {
    let line = |entry: &LogEntry| LogLine {
        start: entry.boot,
        seconds: f64::from(entry.tick) * f64::from(period_us) * 1e-6,
        text: show::blackbox::event(entry.happening),
    };
    Log { events: entries.iter().map(line).collect() }
}
