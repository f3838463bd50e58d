//! Exports recordings for the tools of other projects: MCAP for Foxglove and `PlotJuggler`, PIRDS for the
//! tools of Public Invention.

pub mod mcap;
pub mod pirds;

#[cfg(test)]
mod tests;

use std::path::PathBuf;

use thiserror::Error;

use crate::recording::Recording;

/// Why a file cannot be exported.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum ExportError {
    /// The operating system could not write the file.
    #[error("cannot write {path}: {source}; check the folder and the free space")]
    Write { path: PathBuf, source: std::io::Error },
    /// A capture must not overwrite an earlier one.
    #[error("{0} exists: name a new file, or remove it first")]
    Exists(PathBuf),
    /// The encoder failed.
    #[error("cannot encode {path}: {detail}; check the free space")]
    Encode { path: PathBuf, detail: String },
    /// A recording without a row.
    #[error("the recording has no rows: record at least one breath")]
    Empty,
    /// PIRDS gives times in whole milliseconds.
    #[error(
        "the recording has a control period of {0} us, but PIRDS counts whole milliseconds: \
         export it as .mcap, or record it with a period of 1000 us or more"
    )]
    Period(u32),
    /// A value that the integers of PIRDS cannot hold.
    #[error("{column} is {value} in row {row} (counted from 0), which PIRDS cannot hold: export it as .mcap")]
    Range { column: &'static str, row: usize, value: f32 },
}

/// Time of each row since the first breath's start, us.
///
/// A recording gives breath and tick. Breaths are taken to follow one another without a pause, and a lost
/// tick leaves its time free.
pub fn times_us(recording: &Recording) -> Vec<u64> {
    let period = u64::from(recording.provenance.period_us);
    let mut start = 0;
    let mut times = Vec::with_capacity(recording.len());
    for breath in recording.breaths() {
        let ticks = &recording.tick[breath];
        times.extend(ticks.iter().map(|tick| start + u64::from(*tick) * period));
        start += ticks.last().map_or(0, |last| (u64::from(*last) + 1) * period);
    }
    times
}
