//! The content of a flight recorder, as a page shows it.

use shared::recorder::{LogEntry, SLOW_STRIDE, TickEntry};

use crate::stream::{FlightRecorder, LogLine, Recorded};

/// The entries of a flight recorder, oldest first, as they were read.
#[derive(Debug, Default)]
pub struct Entries {
    /// Every control tick of the last seconds; none marks a gap.
    pub fast: Vec<Option<TickEntry>>,
    /// Every [`SLOW_STRIDE`]th tick of the last minute; none marks a gap.
    pub slow: Vec<Option<TickEntry>>,
    /// The events.
    pub log: Vec<LogEntry>,
}

impl Entries {
    /// The content for a page; a control tick lasts `period_us` microseconds.
    pub fn content(&self, period_us: u32) -> FlightRecorder {
        let tick_s = f64::from(period_us) * 1e-6;
        FlightRecorder {
            fast: Some(recorded(&self.fast, tick_s)),
            slow: Some(recorded(&self.slow, tick_s * f64::from(SLOW_STRIDE))),
            ..events(&self.log, period_us)
        }
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

/// Ticks as columns, `step_s` seconds apart.
fn recorded(entries: &[Option<TickEntry>], step_s: f64) -> Recorded {
    let mut columns = Recorded::default();
    let mut left = entries.iter().flatten().count();
    for entry in entries {
        left -= usize::from(entry.is_some());
        columns.time.push(-(left as f64) * step_s);
        let value = |read: &dyn Fn(&TickEntry) -> f32| entry.as_ref().map_or(f32::NAN, read);
        columns.pressure.push(value(&|entry| entry.pressure));
        columns.target.push(value(&|entry| entry.target.unwrap_or(f32::NAN)));
        columns.u_in.push(value(&|entry| entry.u_in));
        columns.u_out.push(value(&|entry| if entry.u_out { 100.0 } else { 0.0 }));
    }
    columns
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
        let columns =
            recorded(&[Some(entry(5.0, true)), None, Some(entry(6.0, false)), Some(entry(7.0, false))], 0.02);
        assert_eq!(columns.time, [-0.04, -0.04, -0.02, -0.0]);
        assert_eq!((columns.pressure[0], columns.pressure[2], columns.pressure[3]), (5.0, 6.0, 7.0));
        assert!(columns.u_in[1].is_nan() && columns.u_out[1].is_nan() && columns.pressure[1].is_nan());
        assert!(columns.target.iter().all(|target| target.is_nan()));
        assert_eq!((columns.u_out[0], columns.u_out[2]), (100.0, 0.0));
    }
}
