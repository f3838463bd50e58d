//! Rows of a foreign table as numbers in our units.

use std::fs::File;
use std::io::{BufReader, ErrorKind};
use std::path::{Path, PathBuf};

use csv::ByteRecord;

use super::map::{Layout, Origin, Quantity};
use crate::recording::DatasetError;

/// One value per [`Quantity`], in its order and our units.
pub type Fields = [f64; 9];

/// Bytes read from the file at a time.
const BUFFER: usize = 1 << 20;

/// One row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Values; those that the table has not are 0.
    pub fields: Fields,
    /// Whether the column of breaths has another value than in the row before.
    pub next_breath: bool,
    /// Index of the group.
    pub group: u32,
}

impl Sample {
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
    Cell { index: usize, factor: f64, offset: f64 },
}

/// An open table.
#[derive(Debug)]
pub struct Reader<'a> {
    path: PathBuf,
    layout: &'a Layout,
    table: csv::Reader<BufReader<File>>,
    line: ByteRecord,
    places: [Place; 9],
    breath: Option<usize>,
    group: Option<usize>,
    last_breath: Vec<u8>,
    last_group: Vec<u8>,
    current_group: u32,
    started: bool,
}

impl<'a> Reader<'a> {
    /// Opens a table and finds its columns.
    ///
    /// # Errors
    /// The file cannot be read, or lacks a column of the layout.
    pub fn open(path: &Path, layout: &'a Layout) -> Result<Self, DatasetError> {
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
            found.ok_or_else(|| DatasetError::MappedColumn { path: path.to_owned(), column: name.to_owned() })
        };
        let mut places = [Place::Absent; 9];
        for (place, origin) in places.iter_mut().zip(&layout.origins) {
            *place = match origin {
                None => Place::Absent,
                Some(Origin::Value(value)) => Place::Value(*value),
                Some(Origin::Column { name, factor, offset }) => {
                    Place::Cell { index: find(name)?, factor: *factor, offset: *offset }
                }
            };
        }
        let breath = layout.breath.as_deref().map(find).transpose()?;
        let group = layout.group.as_deref().map(find).transpose()?;
        Ok(Self {
            path: path.to_owned(),
            layout,
            table,
            line: ByteRecord::new(),
            places,
            breath,
            group,
            last_breath: Vec::new(),
            last_group: Vec::new(),
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
    pub fn next(&mut self, groups: &mut Vec<String>) -> Result<Option<Sample>, DatasetError> {
        let more = self
            .table
            .read_byte_record(&mut self.line)
            .map_err(|source| DatasetError::TableLine { path: self.path.clone(), source })?;
        if !more {
            return Ok(None);
        }
        let mut fields = [0.0; 9];
        for (n, (field, place)) in fields.iter_mut().zip(&self.places).enumerate() {
            *field = match *place {
                Place::Absent => 0.0,
                Place::Value(value) => value,
                Place::Cell { index, factor, offset } => factor * self.number(n, index)? + offset,
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
        Ok(Some(Sample { fields, next_breath, group }))
    }

    /// Index of the row's group; a table without groups is one, named after its file.
    fn group(&mut self, groups: &mut Vec<String>) -> u32 {
        let cell = self.group.and_then(|index| self.line.get(index)).unwrap_or_default();
        if self.started && cell == self.last_group {
            return self.current_group;
        }
        self.last_group.clear();
        self.last_group.extend_from_slice(cell);
        let name = match self.group {
            Some(_) => String::from_utf8_lossy(cell).trim().to_owned(),
            None => self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        };
        let known = groups.iter().position(|group| *group == name);
        self.current_group = known.unwrap_or_else(|| {
            groups.push(name);
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

    fn bad_cell(&self, quantity: usize, cell: &[u8], reason: &'static str) -> DatasetError {
        let column = match &self.layout.origins[quantity] {
            Some(Origin::Column { name, .. }) => name.clone(),
            _ => Quantity::ALL[quantity].name().to_owned(),
        };
        DatasetError::MappedCell {
            path: self.path.clone(),
            line: self.line.position().map_or(0, csv::Position::line),
            column,
            value: String::from_utf8_lossy(cell).into_owned(),
            reason,
        }
    }
}
