//! Reads rows of a third-party table as numbers in our units.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek};
use std::path::{Path, PathBuf};

use csv::ByteRecord;

use super::map::{ColumnSource, QUANTITIES, Quantity, TableLayout};
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// One value per [`Quantity`], in its order and in our units.
pub type Fields = [f64; QUANTITIES];

/// Tolerance of a command outside 0..100 %, for rounding.
const PERCENT_SLACK: f64 = 0.1;
/// Pressure that no ventilator has, cmH2O.
const PRESSURE_MOST: f64 = 500.0;
/// Command that no valve has, percent: scaled ones may overshoot their range.
const COMMAND_MOST: f64 = 200.0;
/// Number of names of a header that an error shows.
const NAMES: usize = 8;
/// Number of bytes read from the file at a time.
const BUFFER: usize = 1 << 20;

/// A row of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableRow {
    /// Values; 0 for quantities that the table does not have, NaN for a command that is not known.
    pub fields: Fields,
    /// Whether the breath column's value differs from the previous row's.
    pub next_breath: bool,
    /// Index of the group.
    pub group: u32,
}

impl TableRow {
    /// The value of a quantity.
    pub fn get(&self, quantity: Quantity) -> f64 {
        self.fields[quantity as usize]
    }
}

/// A file of which rows are read in their order.
pub(super) trait RowSource {
    /// The next row; `None` at the end. New names are added to `groups`.
    ///
    /// # Errors
    /// Content that cannot be used, with its line.
    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError>;

    /// Number of bytes read so far.
    fn position(&self) -> u64;

    /// Number of events that no row uses, by name.
    fn unused(&self) -> BTreeMap<String, usize> {
        BTreeMap::new()
    }
}

/// Index of a group, which is added if it is new.
pub(super) fn index_of(groups: &mut Vec<TestRun>, run: TestRun) -> u32 {
    let known = groups.iter().position(|group| *group == run);
    known.unwrap_or_else(|| {
        groups.push(run);
        groups.len() - 1
    }) as u32
}

/// Opens a file, unless it is plainly no text in UTF-8.
fn text_file(path: &Path) -> Result<File, DatasetError> {
    let failed = |source: io::Error| match source.kind() {
        ErrorKind::NotFound => DatasetError::Missing(path.to_owned()),
        ErrorKind::IsADirectory => {
            DatasetError::NoTable { path: path.to_owned(), reason: "is a folder: name a table" }
        }
        _ => DatasetError::Read { path: path.to_owned(), source },
    };
    let mut file = File::open(path).map_err(failed)?;
    let mut start = [0; 4];
    let length = file.read(&mut start).map_err(failed)?;
    file.rewind().map_err(failed)?;
    let reason = match start[..length] {
        [] => "is empty",
        [0x1f, 0x8b, ..] => "is compressed: unpack it first, as with gunzip",
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => "is in UTF-16: convert it, as with iconv -f UTF-16 -t UTF-8",
        [b'P', b'A', b'R', b'1'] => "is a Parquet file, not a table in text",
        _ => return Ok(file),
    };
    Err(DatasetError::NoTable { path: path.to_owned(), reason })
}

/// Index of the column with this name.
fn find(path: &Path, header: &ByteRecord, name: &str) -> Result<usize, DatasetError> {
    let mut found = header.iter().enumerate().filter(|(_, head)| head.trim_ascii() == name.as_bytes());
    match (found.next(), found.next()) {
        (Some((index, _)), None) => Ok(index),
        (Some(_), Some(_)) => {
            Err(DatasetError::TableColumns { path: path.to_owned(), column: name.to_owned() })
        }
        (None, _) => Err(DatasetError::TableColumn {
            path: path.to_owned(),
            column: name.to_owned(),
            found: shown(header),
            // A line that was not split has the separator in its only name.
            correct: if header.len() == 1 {
                "the separator in the column map"
            } else {
                "the column map, or that line"
            },
        }),
    }
}

/// The names of a header, the first ones if there are many.
fn shown(header: &ByteRecord) -> String {
    let names = header.iter().take(NAMES).map(|name| format!("`{}`", String::from_utf8_lossy(name).trim()));
    let rest = if header.len() > NAMES { ", ..." } else { "" };
    names.collect::<Vec<_>>().join(", ") + rest
}

/// Why text is no number, and what to do.
fn no_number(text: &str) -> &'static str {
    let one_comma = text.split_once(',').map(|(whole, digits)| format!("{whole}.{digits}"));
    if one_comma.is_some_and(|point| point.parse::<f64>().is_ok()) {
        "is not a number: it has a decimal comma; write decimal points"
    } else if text.contains(':') && text.starts_with(|first: char| first.is_ascii_digit()) {
        "is not a number, but a time of day: write seconds since the first row"
    } else {
        "is not a number: correct the cell, or remove the line, as one that has units"
    }
}

/// An open table.
#[derive(Debug)]
pub struct TableReader<'a> {
    path: PathBuf,
    layout: &'a TableLayout,
    table: csv::Reader<File>,
    line: ByteRecord,
    /// Index of each quantity's column.
    places: [Option<usize>; QUANTITIES],
    breath: Option<usize>,
    group: Option<usize>,
    run: Option<usize>,
    /// The breath column's cell in the previous row.
    last_breath: Option<Vec<u8>>,
    /// The cells of the group and its run in the previous row.
    last_group: Option<[Vec<u8>; 2]>,
    current_group: u32,
}

impl<'a> TableReader<'a> {
    /// Opens a table and finds its columns.
    ///
    /// # Errors
    /// The file cannot be read, or lacks a column of the layout.
    pub fn open(path: &Path, layout: &'a TableLayout) -> Result<Self, DatasetError> {
        let mut table = csv::ReaderBuilder::new()
            .delimiter(layout.separator)
            .buffer_capacity(BUFFER)
            .from_reader(text_file(path)?);
        let header = table
            .byte_headers()
            .map_err(|source| DatasetError::TableLine { path: path.to_owned(), source })?
            .clone();
        let find = |name: &str| find(path, &header, name);
        let mut places = [None; QUANTITIES];
        for (place, origin) in places.iter_mut().zip(&layout.origins) {
            if let Some(ColumnSource::Column { name, .. }) = origin {
                *place = Some(find(name)?);
            }
        }
        let breath = layout.breath.as_deref().map(find).transpose()?;
        let group = layout.group.as_deref().map(find).transpose()?;
        let run = layout.run.as_deref().map(find).transpose()?;
        Ok(Self {
            path: path.to_owned(),
            layout,
            table,
            line: ByteRecord::new(),
            places,
            breath,
            group,
            run,
            last_breath: None,
            last_group: None,
            current_group: 0,
        })
    }

    /// Index of the row's group; a table without groups is one group, named after its file.
    fn group(&mut self, groups: &mut Vec<TestRun>) -> u32 {
        let cell = |index: Option<usize>| index.and_then(|index| self.line.get(index)).unwrap_or_default();
        let cells = [cell(self.group), cell(self.run)];
        if self.last_group.as_ref().is_some_and(|last| cells == *last) {
            return self.current_group;
        }
        let text = |cell: &[u8]| String::from_utf8_lossy(cell).trim().to_owned();
        let run = match (self.group, self.run) {
            (Some(_), Some(_)) => TestRun::new(&text(cells[0]), &text(cells[1])),
            (Some(_), None) => text(cells[0]).into(),
            (None, _) => self.path.file_stem().unwrap_or_default().to_string_lossy().as_ref().into(),
        };
        self.last_group = Some(cells.map(<[u8]>::to_vec));
        self.current_group = index_of(groups, run);
        self.current_group
    }

    /// The cell of a quantity that has a column.
    fn cell(&self, quantity: usize) -> &[u8] {
        let cell = self.places[quantity].and_then(|place| self.line.get(place));
        cell.unwrap_or_default().trim_ascii()
    }

    fn number(&self, quantity: usize) -> Result<f64, DatasetError> {
        let text = std::str::from_utf8(self.cell(quantity)).unwrap_or_default();
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(_) => Err(self.bad_cell(quantity, "is not finite: correct the cell, or remove the line")),
            Err(_) => Err(self.bad_cell(quantity, no_number(text))),
        }
    }

    /// Checks that a command is within its range, with a tolerance for rounding.
    fn percent(&self, quantity: usize, value: f64) -> Result<f64, DatasetError> {
        if (-PERCENT_SLACK..=100.0 + PERCENT_SLACK).contains(&value) {
            return Ok(value.clamp(0.0, 100.0));
        }
        Err(self.bad_cell(
            quantity,
            "is not a command from 0 to 1: correct the cell, or the unit in the column map",
        ))
    }

    /// Checks that a value can be one of a ventilator at all: if not, its unit or scale is wrong.
    fn plausible(&self, quantity: usize, value: f64) -> Result<f64, DatasetError> {
        let most = match Quantity::ALL[quantity] {
            Quantity::Pressure | Quantity::Target => PRESSURE_MOST,
            Quantity::UIn | Quantity::UOut | Quantity::UPsol => COMMAND_MOST,
            _ => f64::INFINITY,
        };
        if value.abs() <= most {
            return Ok(value);
        }
        Err(self.bad_cell(
            quantity,
            "is impossible in this unit: correct the cell, or unit and scale in the column map",
        ))
    }

    fn bad_cell(&self, quantity: usize, reason: &'static str) -> DatasetError {
        let column = match &self.layout.origins[quantity] {
            Some(ColumnSource::Column { name, .. }) => name.clone(),
            _ => Quantity::ALL[quantity].name().to_owned(),
        };
        DatasetError::TableCell {
            path: self.path.clone(),
            line: self.line.position().map_or(0, csv::Position::line),
            column,
            value: String::from_utf8_lossy(self.cell(quantity)).into_owned(),
            reason,
        }
    }
}

impl RowSource for TableReader<'_> {
    fn position(&self) -> u64 {
        self.line.position().map_or(0, csv::Position::byte)
    }

    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let more = self
            .table
            .read_byte_record(&mut self.line)
            .map_err(|source| DatasetError::TableLine { path: self.path.clone(), source })?;
        if !more {
            return Ok(None);
        }
        let mut fields = [0.0; QUANTITIES];
        for (quantity, (field, origin)) in fields.iter_mut().zip(&self.layout.origins).enumerate() {
            *field = match origin {
                None => 0.0,
                Some(ColumnSource::Value(value)) => *value,
                Some(ColumnSource::Column { factor, offset, share, .. }) => {
                    let value = factor * self.number(quantity)? + offset;
                    if *share { self.percent(quantity, value)? } else { self.plausible(quantity, value)? }
                }
            };
        }
        let group = self.group(groups);
        let next_breath = self.breath.is_some_and(|index| {
            let cell = self.line.get(index).unwrap_or_default();
            let other = self.last_breath.as_deref() != Some(cell);
            if other {
                self.last_breath = Some(cell.to_vec());
            }
            other
        });
        Ok(Some(TableRow { fields, next_breath, group }))
    }
}
