//! Reports: tables for the terminal, plots as SVG, and both in one self-contained HTML file.

mod curve;
mod draw;
mod heat_map;
mod html;
mod markdown;
mod plot;
mod role;
mod svg;
mod table;
mod terminal;
#[cfg(test)]
mod tests;
mod text;
mod ticks;

use std::path::PathBuf;

use thiserror::Error;

pub use heat_map::HeatMap;
pub use html::{Block, Report, Section};
pub use plot::{Plot, Series, Style};
pub use role::Role;
pub use table::{Cell, Column, Table};
pub use text::duration;

/// Why a report cannot be created.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum ReportError {
    /// A point is NaN or infinite.
    #[error("plot `{plot}`, series `{series}`: point {index} is not finite: correct the data first")]
    NotFinite { plot: String, series: String, index: usize },
    /// A logarithmic scale cannot show zero or less.
    #[error("plot `{plot}`: a logarithmic scale needs values above 0, found {value}: use a linear one")]
    NotPositive { plot: String, value: f64 },
    /// A given range is empty, reversed or not finite.
    #[error("plot `{plot}`: the range {low}..{high} is not valid: give finite ends, the lower one first")]
    BadRange { plot: String, low: f64, high: f64 },
    /// No series has a point.
    #[error("plot `{0}` has no points: omit it")]
    Empty(String),
    /// The file cannot be written.
    #[error("cannot write {path}: {source}; an existing file of that name is unchanged")]
    Write { path: PathBuf, source: std::io::Error },
}
