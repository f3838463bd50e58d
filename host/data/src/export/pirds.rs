//! PIRDS events, as the tools of Public Invention read them.
//!
//! Each row becomes a reading of the airway pressure and, if the recording has flows, one of the net flow.
//! Each phase begins with a message that gives the target. Valve commands have no type in the standard and
//! are left out.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::ops::Range;
use std::path::Path;

use super::{ExportError, times_us};
use crate::files::write_streamed;
use crate::pirds::{
    AIRWAY, FLOW, GAUGE, Measurement, PER_CMH2O, PER_LITRE_PER_SECOND, PhaseMark, Sensor, message_json,
};
use crate::recording::Recording;

/// Shortest control period, us: times are whole milliseconds.
const LEAST_PERIOD_US: u32 = 1000;
/// Distance from a target below which it counts as reached, cmH2O.
const REACHED: f32 = 0.005;

/// How the events are put into a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// One JSON array, which a browser's tool loads at once.
    Array,
    /// One event in each line, as a stream.
    Lines,
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Written {
    /// Number of readings.
    pub readings: usize,
    /// Number of messages, one for each phase.
    pub messages: usize,
}

/// Writes a recording, atomically replacing an existing file.
///
/// # Errors
/// A recording without a row, with a period below 1 ms or with a value that the standard cannot hold, or a
/// file that cannot be written.
pub fn save(recording: &Recording, layout: Layout, path: &Path) -> Result<Written, ExportError> {
    let period_us = recording.provenance.period_us;
    if recording.is_empty() {
        return Err(ExportError::Empty);
    }
    if period_us < LEAST_PERIOD_US {
        return Err(ExportError::Period(period_us));
    }
    let mut written = Written { readings: 0, messages: 0 };
    let failed = |source: io::Error| ExportError::Write { path: path.to_owned(), source };
    let write = |to: &mut BufWriter<File>| {
        let mut lines = Lines { to, layout, any: false };
        each_event(recording, &mut written, |event| lines.push(event).map_err(failed))?;
        lines.end().map_err(failed)
    };
    write_streamed(path, write, failed)?;
    Ok(written)
}

/// The events of a file in its layout.
struct Lines<'a, W> {
    to: &'a mut W,
    layout: Layout,
    any: bool,
}

impl<W: Write> Lines<'_, W> {
    fn push(&mut self, event: &str) -> io::Result<()> {
        let before = match (self.layout, std::mem::replace(&mut self.any, true)) {
            (Layout::Lines, false) => "",
            (Layout::Lines, true) => "\n",
            (Layout::Array, false) => "[\n",
            (Layout::Array, true) => ",\n",
        };
        write!(self.to, "{before}{event}")
    }

    fn end(&mut self) -> io::Result<()> {
        self.to.write_all(if self.layout == Layout::Array { b"\n]\n" } else { b"\n" })
    }
}

/// Passes on the events of a recording in their order, and counts them.
fn each_event(
    recording: &Recording,
    written: &mut Written,
    mut each: impl FnMut(&str) -> Result<(), ExportError>,
) -> Result<(), ExportError> {
    let times = times_us(recording);
    for breath in recording.breaths() {
        for phase in phases(recording, breath) {
            let (start, mark) = mark(recording, &times, &phase)?;
            each(&message_json(start, &mark.to_string()))?;
            written.messages += 1;
            for row in phase {
                let ms = ms(times[row], row)?;
                for (kind, value) in readings(recording, row)? {
                    let sensor = Sensor { kind, location: AIRWAY, number: 0 };
                    each(&Measurement { sensor, ms, value, beyond_range: false }.to_json())?;
                    written.readings += 1;
                }
            }
        }
    }
    Ok(())
}

/// Rows of each phase of a breath.
fn phases(recording: &Recording, breath: Range<usize>) -> Vec<Range<usize>> {
    let mut start = breath.start;
    let chunks = recording.phase[breath].chunk_by(|a, b| a == b);
    chunks
        .map(|chunk| {
            start += chunk.len();
            start - chunk.len()..start
        })
        .collect()
}

/// The mark of a phase, and its time in ms. A target that is not a straight line and a rest is written as if
/// it were.
fn mark(recording: &Recording, times: &[u64], phase: &Range<usize>) -> Result<(u32, PhaseMark), ExportError> {
    let (first, targets) = (phase.start, &recording.target[phase.clone()]);
    let (from, to) = (targets[0], targets[targets.len() - 1]);
    let reached = targets.iter().position(|target| (target - to).abs() <= REACHED).unwrap_or_default();
    let start = ms(times[first], first)?;
    let in_ms = ms(times[first + reached], first)? - start;
    Ok((start, PhaseMark { breath: recording.breath[first], phase: recording.phase[first], from, to, in_ms }))
}

/// The readings of a row: pressure, and the net flow if both flows are known.
fn readings(recording: &Recording, row: usize) -> Result<Vec<(char, i32)>, ExportError> {
    let mut readings = vec![(GAUGE, scaled("pressure", row, recording.pressure[row], PER_CMH2O)?)];
    if let (Some(inward), Some(outward)) = (&recording.flow_in, &recording.flow_out) {
        readings.push((FLOW, scaled("flow", row, inward[row] - outward[row], PER_LITRE_PER_SECOND)?));
    }
    Ok(readings)
}

fn scaled(column: &'static str, row: usize, value: f32, scale: f64) -> Result<i32, ExportError> {
    let units = (f64::from(value) * scale).round();
    if (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&units) {
        return Ok(units as i32);
    }
    Err(ExportError::Range { column, row, value })
}

/// A time in whole milliseconds.
fn ms(time_us: u64, row: usize) -> Result<u32, ExportError> {
    let out_of_range = |_| ExportError::Range { column: "time", row, value: time_us as f32 * 1e-6 };
    u32::try_from((time_us + 500) / 1000).map_err(out_of_range)
}
