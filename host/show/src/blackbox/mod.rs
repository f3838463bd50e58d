//! The content of a device's flight recorder as text, tables, a CSV file and plots.

mod csv;
mod figures;
#[cfg(test)]
mod tests;

pub use csv::csv;
pub use figures::report;
use shared::control::memory::Lesson;
use shared::recorder::{ChipEvent, Happening, LogEntry, RecordingState};
use shared::weights::ImageId;

use crate::monitor::words;
use crate::report::{Cell, Table};
use device::blackbox::{Blackbox, RecordedTicks};

/// A sentence that describes the recording.
pub fn story(blackbox: &Blackbox) -> String {
    let status = &blackbox.status;
    let moment = words::moment(status.tick.into(), blackbox.period_us);
    let when = format!("{moment} after start {}", status.tick_boot);
    let story = match status.recording {
        RecordingState::Nothing => "nothing: it was cleared, or the device has not ventilated yet".to_owned(),
        RecordingState::Running => format!("in progress: the device ventilates, started {when}"),
        RecordingState::Stopped => format!("ended by a stop, {when}"),
        RecordingState::Fault(fault) => format!("ended by a fault, {when}: {}", words::fault(fault)),
        RecordingState::Reset => format!("ended by a reset while ventilating, {when}"),
    };
    if blackbox.from_flash {
        format!("{story} (read back from its copy in flash after a loss of power)")
    } else {
        story
    }
}

/// A summary in a few lines; `device` identifies the device.
pub fn summary(blackbox: &Blackbox, device: &str) -> Table {
    let mut table = Table::new("", &["flight recorder", device]);
    let mut row = |name: &str, value: String| table.row(vec![Cell::text(name), Cell::text(value)]);
    row("recording", story(blackbox));
    row("every tick", extent(&blackbox.fast));
    row("every 20th tick", extent(&blackbox.slow));
    let (events, starts) = (blackbox.log.len(), blackbox.status.boot);
    row("events", format!("{events}, from {starts} starts"));
    if blackbox.unread > 0 {
        row("unreadable events", format!("{}, damaged or from a newer device", blackbox.unread));
    }
    table
}

/// Duration of a trace, and its range of pressures.
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

/// The newest `limit` events of the log, oldest first.
pub fn events(blackbox: &Blackbox, limit: usize) -> Table {
    let left_out = blackbox.log.len().saturating_sub(limit);
    let title = if left_out > 0 { format!("events, {left_out} older ones omitted") } else { String::new() };
    let mut table = Table::new(title, &["start", "s", "event"]);
    for LogEntry { tick, boot, happening } in &blackbox.log[left_out..] {
        let seconds = f64::from(*tick) * f64::from(blackbox.period_us) * 1e-6;
        table.row(vec![Cell::count((*boot).into()), Cell::number(seconds, 3), Cell::text(event(*happening))]);
    }
    table
}

/// Description of an event of the chip.
fn chip(event: ChipEvent) -> &'static str {
    match event {
        ChipEvent::NoCrystal => {
            "the crystal did not start: runs on the internal oscillator, times may be off by some percent"
        }
        ChipEvent::CrystalStopped => {
            "the crystal has stopped: runs on the internal oscillator, times may be off by some percent"
        }
        ChipEvent::SupplyLow => "the supply voltage was low",
        ChipEvent::BrownOutLevelSet => "programmed the brown-out level",
        ChipEvent::BrownOutLevelWrong => {
            "the brown-out level is wrong: program the option bytes (docs/HARDWARE.md)"
        }
        ChipEvent::RecorderRestored => "the flight recorder was restored from its copy in flash",
        ChipEvent::AbsentTooLong => "ventilation was not resumed: interrupted for more than 15 minutes",
        ChipEvent::AbsenceUnknown => {
            "ventilation was not resumed: no clock tells how long the supply was away"
        }
        ChipEvent::PrescriptionDamaged => "ventilation was not resumed: the kept settings are damaged",
        ChipEvent::ResumedTooOften => "ventilation was not resumed: the program fails again and again",
    }
}

/// Description of an event.
pub fn event(happening: Happening) -> String {
    match happening {
        Happening::Boot { cause, failed } => {
            let after = if failed { ", after the program failed" } else { "" };
            format!("started by: {}{after}", words::reset(cause))
        }
        Happening::Weights(id) => format!("loaded weights {}", ImageId(id)),
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
        Happening::Cleared => "recording cleared by a host".to_owned(),
        Happening::Chip(event) => chip(event).to_owned(),
        Happening::Lesson(Lesson::Adopt) => "the controller learns from the breaths".to_owned(),
        Happening::Lesson(Lesson::Discard) => "the controller leaves out a breath".to_owned(),
        Happening::Lesson(Lesson::Forget) => "the controller has forgotten the earlier breaths".to_owned(),
    }
}
