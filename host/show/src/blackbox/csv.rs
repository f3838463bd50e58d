//! The recorded ticks as a CSV file.

use data::recording::PHASE_NAMES;
use shared::breath::Phase;
use shared::recorder::{Activity, TickEntry};

use device::blackbox::{Blackbox, RecordedTicks};

/// Columns. The time is 0 at each part's newest entry.
const HEAD: &str =
    "part,time_s,pressure_cmH2O,target_cmH2O,u_in_percent,u_out,phase,explored,activity,breath_mod_16";

/// Both parts, one line per tick. A line with only the part's name marks a gap; an empty field is a missing number.
pub fn csv(blackbox: &Blackbox) -> String {
    let mut text = format!("{HEAD}\n");
    for (name, trace) in [("fast", &blackbox.fast), ("slow", &blackbox.slow)] {
        text.extend(lines(name, trace));
    }
    text
}

fn lines<'a>(name: &'a str, trace: &'a RecordedTicks) -> impl Iterator<Item = String> + 'a {
    trace.timed().map(move |(time, tick)| match tick {
        Some(tick) => format!("{name},{time:.3},{}\n", fields(tick)),
        None => format!("{name},,,,,,,,,\n"),
    })
}

fn fields(tick: &TickEntry) -> String {
    let number = |value: Option<f32>, decimals: usize| match value {
        Some(value) if !value.is_nan() => format!("{value:.decimals$}"),
        _ => String::new(),
    };
    let [inspiration, fall, expiration] = PHASE_NAMES;
    let phase = match tick.phase {
        Some(Phase::Inspiration) => inspiration,
        Some(Phase::Fall) => fall,
        Some(Phase::Expiration) => expiration,
        None => "",
    };
    let activity = match tick.activity {
        Activity::Standby => "standby",
        Activity::Ventilating => "ventilating",
        Activity::Fault => "fault",
    };
    let (pressure, target) = (number(Some(tick.pressure), 2), number(tick.target, 2));
    let (u_in, u_out) = (number(Some(tick.u_in), 1), u8::from(tick.u_out));
    let (explored, breath) = (u8::from(tick.explored), tick.breath);
    format!("{pressure},{target},{u_in},{u_out},{phase},{explored},{activity},{breath}")
}
