//! The formats of files that need no column map, told by the start of their content.

use std::io::Read;
use std::path::Path;

use super::map::{Column, ColumnMap, MapError, TableLayout};
use super::table::text::{Text, name};
use super::{makair, pb840, servo_u};
use crate::pirds::is_logged;
use crate::recording::DatasetError;

/// Bytes that show the format.
const START: u64 = 1 << 16;
/// Lines among which the names of a table's columns are.
const LINES: usize = 64;

/// How to read files.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "one exists")]
pub enum Format {
    /// A table with these columns.
    Table(TableLayout),
    /// Events of PIRDS.
    Pirds,
    /// Telemetry of a `MakAir`.
    Makair,
    /// Waveforms of a Puritan Bennett 840.
    Pb840,
    /// Recordings of a SERVO-U.
    ServoU,
}

impl Format {
    /// Names of the formats, as `--format` takes them; `csv` needs a column map.
    pub const NAMES: [&'static str; 7] =
        ["makair", "pb840", "servo-u", "pirds", "kaggle", "respiraworks", CSV];

    /// The format of this name; none for a table that needs a column map, or an unknown name.
    pub fn named(name: &str) -> Option<Self> {
        let table = |map: Result<ColumnMap, MapError>| map.and_then(|map| map.layout()).ok().map(Self::Table);
        match name {
            "makair" => Some(Self::Makair),
            "pb840" => Some(Self::Pb840),
            "servo-u" => Some(Self::ServoU),
            "pirds" => Some(Self::Pirds),
            "kaggle" => table(ColumnMap::kaggle()),
            "respiraworks" => table(ColumnMap::respiraworks()),
            _ => None,
        }
    }

    /// The name of a file's format by its content.
    ///
    /// # Errors
    /// A file that cannot be read, is plainly no text, or has no waveforms.
    pub fn name_of(path: &Path) -> Result<&'static str, DatasetError> {
        let mut start = Vec::new();
        let read = |source| DatasetError::Read { path: path.to_owned(), source };
        Text::open(path)?.reader.take(START).read_to_end(&mut start).map_err(read)?;
        let lines: Vec<String> =
            start.split(|byte| *byte == b'\n').map(name).filter(|line| !line.is_empty()).collect();
        let first = lines.first().map_or("", String::as_str);
        if servo_u::is_other(first) {
            let reason =
                "is no recording of a SERVO-U, which begins with [REC]: export waveforms, not trends or logs";
            return Err(DatasetError::NoTable { path: path.to_owned(), reason });
        }
        Ok(if servo_u::is_recording(first) {
            "servo-u"
        } else if first.starts_with(['[', '{']) || is_logged(first) {
            "pirds"
        } else if lines.iter().any(|line| makair::is_message(line.as_bytes())) {
            "makair"
        } else if lines.iter().any(|line| pb840::begins_breath(line)) {
            "pb840"
        } else {
            let heads = &lines[..lines.len().min(LINES)];
            ["kaggle", "respiraworks"].into_iter().find(|name| has_columns(name, heads)).unwrap_or(CSV)
        })
    }
}

/// Name of a table that needs a column map.
pub const CSV: &str = "csv";

/// Whether one of the lines has all columns of a known table.
fn has_columns(format: &str, lines: &[String]) -> bool {
    let Some(Format::Table(layout)) = Format::named(format) else { return false };
    lines.iter().any(|line| {
        let names: Vec<&str> = line.split(',').map(|name| name.trim().trim_matches('"')).collect();
        layout.columns().filter_map(Column::name).all(|wanted| names.contains(&wanted))
    })
}
