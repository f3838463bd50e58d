//! The content of a flight recorder, as a page shows it.

use device::blackbox::{Blackbox, RecordedTicks};
use shared::recorder::{LogEntry, TickEntry};
use shared::ventilator::opening;

use crate::stream::{FlightRecorder, LogLine, Recorded};

/// The content for a page.
pub fn content(blackbox: &Blackbox) -> FlightRecorder {
    FlightRecorder {
        fast: Some(columns(&blackbox.fast)),
        slow: Some(columns(&blackbox.slow)),
        ..events(&blackbox.log, blackbox.period_us)
    }
}

/// The events for a page, without ticks; a control tick lasts `period_us` microseconds.
pub fn events(entries: &[LogEntry], period_us: u32) -> FlightRecorder {
    let line = |entry: &LogEntry| LogLine {
        start: entry.boot,
        seconds: f64::from(entry.tick) * f64::from(period_us) * 1e-6,
        text: show::blackbox::event(entry.happening),
    };
    FlightRecorder { events: entries.iter().map(line).collect(), fast: None, slow: None }
}

fn columns(ticks: &RecordedTicks) -> Recorded {
    let column = |read: fn(&TickEntry) -> f32| {
        ticks.entries.iter().map(|entry| entry.as_ref().map_or(f32::NAN, read)).collect()
    };
    Recorded {
        time: ticks.timed().map(|(time, _)| time).collect(),
        pressure: column(|entry| entry.pressure),
        target: column(|entry| entry.target.unwrap_or(f32::NAN)),
        u_in: column(|entry| entry.u_in),
        u_out: column(|entry| opening(entry.u_out)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::recorder::Activity;

    fn entry(pressure: f32, u_out: bool) -> TickEntry {
        let (target, phase, activity) = (None, None, Activity::Ventilating);
        TickEntry { pressure, target, u_in: 40.0, u_out, phase, explored: false, activity, breath: 0 }
    }

    #[test]
    fn ticks_end_at_zero_and_a_gap_is_a_row_without_values_that_takes_no_time() {
        let [first, second, third] =
            [(5.0, true), (6.0, false), (7.0, false)].map(|(p, open)| Some(entry(p, open)));
        let columns = columns(&RecordedTicks { step_s: 0.02, entries: vec![first, None, second, third] });
        assert_eq!(columns.time, [-0.04, -0.04, -0.02, -0.0]);
        assert_eq!((columns.pressure[0], columns.pressure[2], columns.pressure[3]), (5.0, 6.0, 7.0));
        assert!(columns.u_in[1].is_nan() && columns.u_out[1].is_nan() && columns.pressure[1].is_nan());
        assert!(columns.target.iter().all(|target| target.is_nan()));
        assert_eq!((columns.u_out[0], columns.u_out[2]), (100.0, 0.0));
    }
}
