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
pub use table::{Cell, Table};

/// Why a report cannot be made.
#[derive(Debug, Error)]
pub enum ReportError {
    /// A point is NaN or infinite.
    #[error("plot `{plot}`, series `{series}`: point {index} is not finite: repair the data before plotting")]
    NotFinite {
        /// Title of the plot.
        plot: String,
        /// Name of the series.
        series: String,
        /// Index of the first such point.
        index: usize,
    },
    /// A logarithmic scale cannot show zero or less.
    #[error("plot `{plot}`: a logarithmic scale needs values above 0, found {value}: use a linear one")]
    NotPositive {
        /// Title of the plot.
        plot: String,
        /// The value found.
        value: f64,
    },
    /// A given range is empty, reversed or not finite.
    #[error("plot `{plot}`: the range {low}..{high} is no range: give the lower end first")]
    BadRange {
        /// Title of the plot.
        plot: String,
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// There is no point in any series.
    #[error("plot `{plot}` has no points: leave it out")]
    Empty {
        /// Title of the plot.
        plot: String,
    },
    /// The drawing library failed.
    #[error("cannot draw plot `{plot}`: {detail}")]
    Draw {
        /// Title of the plot.
        plot: String,
        /// The library's reason.
        detail: String,
    },
    /// The file cannot be written.
    #[error("cannot write {path}: {source}; an older file of that name is unchanged")]
    Write {
        /// The file to be written.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
}
