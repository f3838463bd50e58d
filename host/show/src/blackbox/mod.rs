//! What a device's flight recorder held, for people: in words, as tables, as a CSV file, in pictures.

mod csv;
mod figures;
#[cfg(test)]
mod tests;

pub use csv::csv;
pub use figures::report;
use shared::recorder::{Happening, LogEntry, RecordingState};

use crate::monitor::words;
use crate::report::{Cell, Table};
use device::blackbox::{Blackbox, RecordedTicks};

/// What the recording is about, in a sentence.
pub fn story(blackbox: &Blackbox) -> String {
    let status = &blackbox.status;
    let moment = words::moment(status.tick.into(), blackbox.period_us);
    let when = format!("{moment} after start {}", status.tick_boot);
    match status.recording {
        RecordingState::Nothing => "nothing: it was emptied, or the device has not ventilated yet".to_owned(),
        RecordingState::Running => format!("goes on: the device ventilates, begun {when}"),
        RecordingState::Stopped => format!("ended by a stop, {when}"),
        RecordingState::Fault(fault) => format!("ended by a fault, {when}: {}", words::fault(fault)),
        RecordingState::Reset => format!("ended by a reset while ventilating, {when}"),
    }
}

/// The whole in a few lines; `device` says whose it is.
pub fn summary(blackbox: &Blackbox, device: &str) -> Table {
    let mut table = Table::new("", &["flight recorder", device]);
    let mut row = |name: &str, value: String| table.row(vec![Cell::text(name), Cell::text(value)]);
    row("recording", story(blackbox));
    row("every tick", extent(&blackbox.fast));
    row("every 20th tick", extent(&blackbox.slow));
    let (events, starts) = (blackbox.log.len(), blackbox.status.boot);
    row("events", format!("{events}, of {starts} starts since the memory was without power"));
    if blackbox.unread > 0 {
        row("events left out", format!("{}, damaged or of a newer device", blackbox.unread));
    }
    table
}

/// How long a trace is, and its pressures.
fn extent(trace: &RecordedTicks) -> String {
    let (count, seconds) = (trace.ticks().count(), trace.ticks().count() as f64 * trace.step_s);
    let numbers = || trace.ticks().map(|tick| tick.pressure).filter(|pressure| !pressure.is_nan());
    let (lowest, highest) = (numbers().reduce(f32::min), numbers().reduce(f32::max));
    match (lowest, highest) {
        _ if count == 0 => "empty".to_owned(),
        (Some(lowest), Some(highest)) => format!("{seconds:.2} s, {lowest:.2} to {highest:.2} cmH2O"),
        _ => format!("{seconds:.2} s, without any pressure reading"),
    }
}

/// The newest events of the log, oldest first; `limit` says how many.
pub fn events(blackbox: &Blackbox, limit: usize) -> Table {
    let left_out = blackbox.log.len().saturating_sub(limit);
    let title = if left_out > 0 { format!("events, {left_out} older ones left out") } else { String::new() };
    let mut table = Table::new(title, &["start", "s", "event"]);
    for LogEntry { tick, boot, happening } in &blackbox.log[left_out..] {
        let seconds = f64::from(*tick) * f64::from(blackbox.period_us) * 1e-6;
        table.row(vec![Cell::count((*boot).into()), Cell::number(seconds, 3), Cell::text(event(*happening))]);
    }
    table
}

/// What happened, in words.
pub fn event(happening: Happening) -> String {
    match happening {
        Happening::Boot { cause, failed } => {
            let after = if failed { ", after the program had failed" } else { "" };
            format!("started by: {}{after}", words::reset(cause))
        }
        Happening::Weights(id) => format!("loaded weights {id:08x}"),
        Happening::Start => "ventilation started".to_owned(),
        Happening::Stop => "ventilation stopped".to_owned(),
        Happening::Fault(fault) => format!("fault: {}", words::fault(fault)),
        Happening::Acknowledged => "fault acknowledged".to_owned(),
        Happening::Controller { learned } => {
            format!("controller: {}", if learned { "learned" } else { "PID" })
        }
        Happening::Settings { pip, peep, rate } => {
            format!("settings: pip {pip} cmH2O, peep {peep} cmH2O, rate {rate} 1/min")
        }
        Happening::Missed { ticks } => format!("{ticks} ticks missed so far"),
        Happening::Alarm(fault) => format!("alarm: {}", words::fault(fault)),
        Happening::Cleared => "recording emptied by a host".to_owned(),
    }
}
