//! Rows of a foreign table as numbers in our units.

use std::fs::File;
use std::io::{BufReader, ErrorKind};
use std::path::{Path, PathBuf};

use csv::ByteRecord;

use super::map::{ColumnSource, QUANTITIES, Quantity, TableLayout};
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// One value per [`Quantity`], in its order and our units.
pub type Fields = [f64; QUANTITIES];

/// A command may lie this far outside 0..100 %, by rounding.
const PERCENT_SLACK: f64 = 0.1;
/// Bytes read from the file at a time.
const BUFFER: usize = 1 << 20;

/// One row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableRow {
    /// Values; those that the table has not are 0.
    pub fields: Fields,
    /// Whether the column of breaths has another value than in the row before.
    pub next_breath: bool,
    /// Index of the group.
    pub group: u32,
}

impl TableRow {
    /// One of its values.
    pub fn get(&self, quantity: Quantity) -> f64 {
        self.fields[quantity as usize]
    }
}

/// Where a quantity stands in a line.
#[derive(Debug, Clone, Copy)]
enum Place {
    Absent,
    Value(f64),
    Cell { index: usize, factor: f64, offset: f64, share: bool },
}

/// An open table.
#[derive(Debug)]
pub struct TableReader<'a> {
    path: PathBuf,
    layout: &'a TableLayout,
    table: csv::Reader<BufReader<File>>,
    line: ByteRecord,
    places: [Place; QUANTITIES],
    breath: Option<usize>,
    group: Option<usize>,
    run: Option<usize>,
    last_breath: Vec<u8>,
    /// Cells of the group and its run in the row before.
    last_group: [Vec<u8>; 2],
    current_group: u32,
    started: bool,
}

impl<'a> TableReader<'a> {
    /// Opens a table and finds its columns.
    ///
    /// # Errors
    /// The file cannot be read, or lacks a column of the layout.
    pub fn open(path: &Path, layout: &'a TableLayout) -> Result<Self, DatasetError> {
        let file = File::open(path).map_err(|source| match source.kind() {
            ErrorKind::NotFound => DatasetError::Missing { path: path.to_owned() },
            _ => DatasetError::Read { path: path.to_owned(), source },
        })?;
        let mut table = csv::ReaderBuilder::new()
            .delimiter(layout.separator)
            .from_reader(BufReader::with_capacity(BUFFER, file));
        let header = table
            .headers()
            .map_err(|source| DatasetError::TableLine { path: path.to_owned(), source })?
            .clone();
        let find = |name: &str| {
            let found = header.iter().position(|head| head.trim() == name);
            found.ok_or_else(|| DatasetError::TableColumn { path: path.to_owned(), column: name.to_owned() })
        };
        let mut places = [Place::Absent; QUANTITIES];
        for (place, origin) in places.iter_mut().zip(&layout.origins) {
            *place = match origin {
                None => Place::Absent,
                Some(ColumnSource::Value(value)) => Place::Value(*value),
                Some(ColumnSource::Column { name, factor, offset, share }) => {
                    Place::Cell { index: find(name)?, factor: *factor, offset: *offset, share: *share }
                }
            };
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
            last_breath: Vec::new(),
            last_group: Default::default(),
            current_group: 0,
            started: false,
        })
    }

    /// Bytes read so far.
    pub fn position(&self) -> u64 {
        self.line.position().map_or(0, csv::Position::byte)
    }

    /// The next row; none at the end. `groups` grows by the names that are new.
    ///
    /// # Errors
    /// A line that cannot be split into cells, or a cell that is no finite number.
    pub fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let more = self
            .table
            .read_byte_record(&mut self.line)
            .map_err(|source| DatasetError::TableLine { path: self.path.clone(), source })?;
        if !more {
            return Ok(None);
        }
        let mut fields = [0.0; QUANTITIES];
        for (n, (field, place)) in fields.iter_mut().zip(&self.places).enumerate() {
            *field = match *place {
                Place::Absent => 0.0,
                Place::Value(value) => value,
                Place::Cell { index, factor, offset, share } => {
                    let value = factor * self.number(n, index)? + offset;
                    if share { self.percent(n, index, value)? } else { value }
                }
            };
        }
        let group = self.group(groups);
        let next_breath = self.breath.is_some_and(|index| {
            let cell = self.line.get(index).unwrap_or_default();
            let other = !self.started || cell != self.last_breath;
            if other {
                self.last_breath.clear();
                self.last_breath.extend_from_slice(cell);
            }
            other
        });
        self.started = true;
        Ok(Some(TableRow { fields, next_breath, group }))
    }

    /// Index of the row's group; a table without groups is one, named after its file.
    fn group(&mut self, groups: &mut Vec<TestRun>) -> u32 {
        let cell = |index: Option<usize>| index.and_then(|index| self.line.get(index)).unwrap_or_default();
        let cells = [cell(self.group), cell(self.run)];
        if self.started && cells == self.last_group.each_ref().map(Vec::as_slice) {
            return self.current_group;
        }
        let text = |cell: &[u8]| String::from_utf8_lossy(cell).trim().to_owned();
        let run = match (self.group, self.run) {
            (Some(_), Some(_)) => TestRun::new(&text(cells[0]), &text(cells[1])),
            (Some(_), None) => text(cells[0]).into(),
            (None, _) => self.path.file_stem().unwrap_or_default().to_string_lossy().as_ref().into(),
        };
        self.last_group = cells.map(<[u8]>::to_vec);
        let known = groups.iter().position(|group| *group == run);
        self.current_group = known.unwrap_or_else(|| {
            groups.push(run);
            groups.len() - 1
        }) as u32;
        self.current_group
    }

    fn number(&self, quantity: usize, index: usize) -> Result<f64, DatasetError> {
        let cell = self.line.get(index).unwrap_or_default().trim_ascii();
        let number = std::str::from_utf8(cell).ok().and_then(|text| text.parse::<f64>().ok());
        match number {
            Some(number) if number.is_finite() => Ok(number),
            Some(_) => Err(self.bad_cell(quantity, cell, "is not finite")),
            None => Err(self.bad_cell(quantity, cell, "is not a number")),
        }
    }

    /// A command within its range, give or take rounding.
    fn percent(&self, quantity: usize, index: usize, value: f64) -> Result<f64, DatasetError> {
        if (-PERCENT_SLACK..=100.0 + PERCENT_SLACK).contains(&value) {
            return Ok(value.clamp(0.0, 100.0));
        }
        let cell = self.line.get(index).unwrap_or_default().trim_ascii();
        Err(self.bad_cell(quantity, cell, "is not a command from 0 to 1"))
    }

    fn bad_cell(&self, quantity: usize, cell: &[u8], reason: &'static str) -> DatasetError {
        let column = match &self.layout.origins[quantity] {
            Some(ColumnSource::Column { name, .. }) => name.clone(),
            _ => Quantity::ALL[quantity].name().to_owned(),
        };
        DatasetError::TableCell {
            path: self.path.clone(),
            line: self.line.position().map_or(0, csv::Position::line),
            column,
            value: String::from_utf8_lossy(cell).into_owned(),
            reason,
        }
    }
}
