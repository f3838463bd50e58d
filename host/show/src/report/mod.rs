//! What people read: tables in the terminal, plots as SVG, and both in one HTML file that needs nothing else.

mod curve;
mod heat_map;
mod html;
mod markdown;
mod plot;
mod svg;
mod table;
#[cfg(test)]
mod tests;
mod ticks;

use std::path::PathBuf;

use thiserror::Error;

pub use heat_map::HeatMap;
pub use html::{Block, Report, Section};
pub use plot::{Plot, Series, Style};
pub use table::{Cell, Column, Table};

/// Why a report cannot be made.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum ReportError {
    /// A point is NaN or infinite.
    #[error("plot `{plot}`, series `{series}`: point {index} is not finite: repair the data before plotting")]
    NotFinite { plot: String, series: String, index: usize },
    /// A logarithmic scale cannot show zero or less.
    #[error("plot `{plot}`: a logarithmic scale needs values above 0, found {value}: use a linear one")]
    NotPositive { plot: String, value: f64 },
    /// A given range is empty, reversed or not finite.
    #[error("plot `{plot}`: the range {low}..{high} is no range: give the lower end first")]
    BadRange { plot: String, low: f64, high: f64 },
    /// There is no point in any series.
    #[error("plot `{0}` has no points: leave it out")]
    Empty(String),
    /// The drawing library failed.
    #[error("cannot draw plot `{plot}`: {detail}")]
    Draw { plot: String, detail: String },
    /// The file cannot be written.
    #[error("cannot write {path}: {source}; an older file of that name is unchanged")]
    Write { path: PathBuf, source: std::io::Error },
}
