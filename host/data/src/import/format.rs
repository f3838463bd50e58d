//! The formats of files that need no column map, told by the start of their content.

use std::io::Read;
use std::path::Path;

use super::map::{Column, ColumnMap, ColumnSource, MapError, Quantity, Signed, TableLayout};
use super::table::text::{Text, name};
use super::{makair, pb840};
use crate::recording::DatasetError;

/// Bytes that show the format.
const START: u64 = 1 << 16;
/// Lines of them.
const LINES: usize = 64;
/// First line of a SERVO-U's recording, and the one before its table.
const SERVO_U: &str = "[REC]";
const SERVO_U_DATA: &str = "[DATA]";

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
            "servo-u" => Some(Self::Table(servo_u())),
            "pirds" => Some(Self::Pirds),
            "kaggle" => table(ColumnMap::kaggle()),
            "respiraworks" => table(ColumnMap::respiraworks()),
            _ => None,
        }
    }

    /// The name of a file's format by its content.
    ///
    /// # Errors
    /// A file that cannot be read, or is plainly no text.
    pub fn name_of(path: &Path) -> Result<&'static str, DatasetError> {
        let mut start = Vec::new();
        let read = |source| DatasetError::Read { path: path.to_owned(), source };
        Text::open(path)?.reader.take(START).read_to_end(&mut start).map_err(read)?;
        let lines: Vec<String> = start
            .split(|byte| *byte == b'\n')
            .map(name)
            .filter(|line| !line.is_empty())
            .take(LINES)
            .collect();
        let first = lines.first().map_or("", String::as_str);
        Ok(if first.starts_with(SERVO_U) {
            "servo-u"
        } else if first.starts_with(['[', '{']) {
            "pirds"
        } else if lines.iter().take(LINES).any(|line| makair::is_message(line.as_bytes())) {
            "makair"
        } else if lines.iter().any(|line| pb840::begins_breath(line)) {
            "pb840"
        } else {
            ["kaggle", "respiraworks"].into_iter().find(|name| has_columns(name, &lines)).unwrap_or(CSV)
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

/// A recording of a SERVO-U: settings in the language of the ventilator, then a table with tabs: time of day, phase, pressure (cmH2O),
/// flow (L/min), volume (mL), trigger.
fn servo_u() -> TableLayout {
    let note = "SERVO-U: no valve commands and no set-point are recorded, u_in is 0";
    let mut layout = TableLayout::of_format("SERVO-U", note, |_| false);
    let column = |number, factor| {
        Some(ColumnSource::Column { column: Column::Number(number), factor, offset: 0.0, share: false })
    };
    layout.origins[Quantity::Time as usize] = column(1, 1.0);
    layout.origins[Quantity::Pressure as usize] = column(3, 1.0);
    for flow in [Quantity::FlowIn, Quantity::FlowOut] {
        layout.origins[flow as usize] = column(4, 1.0 / 60.0);
    }
    TableLayout {
        separator: b'\t',
        decimal: b',',
        after: Some(SERVO_U_DATA),
        signed: Some(Signed::Flow),
        ..layout
    }
}
