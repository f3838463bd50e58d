//! Reads the rows of a third-party table as numbers in our units.

pub(super) mod cells;
mod header;
pub(super) mod text;

use std::collections::HashSet;
use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use csv::ByteRecord;

use self::cells::{Clock, no_number, number};
use self::header::Header;
use self::text::Text;
use super::map::{ColumnSource, QUANTITIES, Quantity, Signed, TableLayout};
use super::rows::{Disorder, RowSource, TableRow, index_of};
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// Tolerance of a command outside 0..100 %, for rounding.
const PERCENT_SLACK: f64 = 0.1;
/// Pressure that no ventilator has, cmH2O.
const PRESSURE_MOST: f64 = 500.0;
/// Command that no valve has, percent: scaled ones may overshoot their range.
const COMMAND_MOST: f64 = 200.0;
/// Bytes that are split at a time.
const BUFFER: usize = 1 << 18;
/// Lines below the names that may have words, such as units.
const HEADS_MOST: usize = 3;
/// Periods between two recordings in a table without times.
const APART_ROWS: usize = 100;
/// Rows from which on the order of breaths is judged.
const ORDER_ROWS: usize = 100;
/// Rows that a breath has at least, on average.
const BREATH_ROWS: usize = 4;

/// An open table.
pub(super) struct TableReader<'a> {
    path: PathBuf,
    layout: &'a TableLayout,
    period_s: f64,
    table: csv::Reader<Box<dyn Read + Send>>,
    bytes: Arc<AtomicU64>,
    lines_before: u64,
    line: ByteRecord,
    /// Index of each quantity's column.
    places: [Option<usize>; QUANTITIES],
    breath: Option<usize>,
    group: Option<usize>,
    run: Option<usize>,
    clock: Clock,
    /// Names of the columns; empty if the table has none.
    names: Vec<String>,
    rows: usize,
    /// Lines in place of rows: all of them, and those since the names.
    heads: usize,
    heads_here: usize,
    /// Whether the names have just come again, as those of another recording.
    begins_again: bool,
    breaths: Breaths,
    /// The cells of the group and its run in the previous row.
    last_group: Option<[Vec<u8>; 2]>,
    current_group: u32,
}

impl<'a> TableReader<'a> {
    /// Opens a table and finds its columns; `period_s` is used if the table has no times.
    ///
    /// # Errors
    /// The file cannot be read, or lacks a column of the layout.
    pub fn open(path: &Path, layout: &'a TableLayout, period_s: f64) -> Result<Self, DatasetError> {
        let Text { mut reader, bytes } = Text::open(path)?;
        let mut header = Header::read(path, &mut reader, layout)?;
        let rest = Cursor::new(std::mem::take(&mut header.rest)).chain(reader);
        let table = csv::ReaderBuilder::new()
            .delimiter(layout.separator)
            .comment(layout.comment)
            .has_headers(false)
            .buffer_capacity(BUFFER)
            .from_reader(Box::new(rest) as Box<dyn Read + Send>);
        let find = |column| header.index(path, column);
        let mut places = [None; QUANTITIES];
        for (place, origin) in places.iter_mut().zip(&layout.origins) {
            if let Some(ColumnSource::Column { column, .. }) = origin {
                *place = Some(find(column)?);
            }
        }
        Ok(Self {
            path: path.to_owned(),
            layout,
            period_s,
            table,
            bytes,
            lines_before: header.lines,
            line: ByteRecord::new(),
            places,
            breath: layout.breath.as_ref().map(find).transpose()?,
            group: layout.group.as_ref().map(find).transpose()?,
            run: layout.run.as_ref().map(find).transpose()?,
            clock: Clock::default(),
            names: header.names,
            rows: 0,
            heads: 0,
            heads_here: 0,
            begins_again: false,
            breaths: Breaths::default(),
            last_group: None,
            current_group: 0,
        })
    }

    /// Reads the next line; false at the end.
    fn advance(&mut self) -> Result<bool, DatasetError> {
        self.table.read_byte_record(&mut self.line).map_err(|error| {
            let line = self.lines_before + error.position().map_or(0, csv::Position::line);
            let reason = match error.kind() {
                csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
                    format!("it has {len} cells, the lines before have {expected_len}")
                }
                _ => error.to_string(),
            };
            DatasetError::TableLine { path: self.path.clone(), line, reason }
        })
    }

    /// Whether the line has the names of the columns: a logger writes them at each start.
    fn has_names(&self) -> bool {
        !self.names.is_empty() && self.line.iter().map(text::name).eq(self.names.iter().map(String::as_str))
    }

    /// The row in the current line; none if it has names or units instead.
    fn row_or_head(&mut self) -> Result<Option<TableRow>, DatasetError> {
        let awaits_units = (self.rows == 0 || self.begins_again) && self.heads_here < HEADS_MOST;
        if awaits_units && self.is_head() {
            (self.heads, self.heads_here) = (self.heads + 1, self.heads_here + 1);
            return Ok(None);
        }
        match self.row() {
            Err(_) if self.has_names() => {
                (self.heads, self.heads_here, self.begins_again) = (self.heads + 1, 0, true);
                self.rows += APART_ROWS;
                self.breaths.forget();
                Ok(None)
            }
            row => row.map(Some),
        }
    }

    /// Whether the line has words in place of all numbers, as one of units has.
    fn is_head(&self) -> bool {
        let mut cells = self.places.iter().flatten().map(|place| self.line.get(*place).unwrap_or_default());
        cells.all(|cell| {
            let text = text::name(cell);
            let time = Clock::default().seconds(&text);
            !text.is_empty() && number(&text, self.layout.decimal).is_none() && time.is_none()
        })
    }

    /// Index of the row's group; a table without groups is one group, named after its file.
    fn group(&mut self, groups: &mut Vec<TestRun>) -> u32 {
        let cell = |index: Option<usize>| index.and_then(|index| self.line.get(index)).unwrap_or_default();
        let cells = [cell(self.group), cell(self.run)];
        if self.last_group.as_ref().is_some_and(|last| cells == *last) {
            return self.current_group;
        }
        let run = match (self.group, self.run) {
            (Some(_), Some(_)) => TestRun::new(&text::name(cells[0]), &text::name(cells[1])),
            (Some(_), None) => text::name(cells[0]).into(),
            (None, _) => self.path.file_stem().unwrap_or_default().to_string_lossy().as_ref().into(),
        };
        self.last_group = Some(cells.map(<[u8]>::to_vec));
        self.current_group = index_of(groups, run);
        self.breaths.forget();
        self.current_group
    }

    /// The cell of a quantity that has a column.
    fn cell(&self, quantity: usize) -> &[u8] {
        let cell = self.places[quantity].and_then(|place| self.line.get(place));
        cell.unwrap_or_default().trim_ascii()
    }

    fn number(&mut self, quantity: usize) -> Result<f64, DatasetError> {
        let text = std::str::from_utf8(self.cell(quantity)).unwrap_or_default();
        if let Some(number) = number(text, self.layout.decimal) {
            return Ok(number);
        }
        if quantity == Quantity::Time as usize {
            let mut clock = self.clock;
            if let Some(seconds) = clock.seconds(text) {
                self.clock = clock;
                return Ok(seconds / self.layout.time_factor());
            }
        }
        if text.parse::<f64>().is_ok() {
            return Err(self.bad_cell(quantity, "is not finite: correct the cell, or remove the line"));
        }
        Err(self.bad_cell(quantity, no_number(text)))
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
            "is impossible in this unit: correct the cell, or unit and scale in the column map; from an absolute pressure \
             subtract the ambient one with `offset`",
        ))
    }

    fn bad_cell(&self, quantity: usize, reason: &'static str) -> DatasetError {
        let column = match &self.layout.origins[quantity] {
            Some(ColumnSource::Column { column, .. }) => column.to_string(),
            _ => Quantity::ALL[quantity].name().to_owned(),
        };
        DatasetError::TableCell {
            path: self.path.clone(),
            line: self.lines_before + self.line.position().map_or(0, csv::Position::line),
            column,
            value: text::name(self.cell(quantity)),
            reason,
        }
    }

    /// The row in the current line.
    fn row(&mut self) -> Result<TableRow, DatasetError> {
        let mut row = TableRow { fields: [0.0; QUANTITIES], next_breath: false, inspires: false, group: 0 };
        let layout = self.layout;
        // One column for both flows is read once.
        let read_already = layout.signed.map(|_| Quantity::FlowOut as usize);
        for (quantity, origin) in layout.origins.iter().enumerate() {
            row.fields[quantity] = match origin.as_ref().filter(|_| Some(quantity) != read_already) {
                None => 0.0,
                Some(ColumnSource::Value(value)) => *value,
                Some(ColumnSource::Column { factor, offset, share, .. }) => {
                    let value = factor * self.number(quantity)? + offset;
                    if *share { self.percent(quantity, value)? } else { self.plausible(quantity, value)? }
                }
            };
        }
        if layout.origins[Quantity::Time as usize].is_none() {
            row.set(Quantity::Time, self.rows as f64 * self.period_s);
        }
        if layout.origins[Quantity::UIn as usize].is_none() {
            row.set(Quantity::UIn, f64::NAN);
        }
        if layout.signed == Some(Signed::Flow) {
            row.set_flow(row.get(Quantity::FlowIn));
        }
        Ok(row)
    }
}

impl RowSource for TableReader<'_> {
    fn position(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let mut row = loop {
            if !self.advance()? {
                return Ok(None);
            }
            if let Some(row) = self.row_or_head()? {
                break row;
            }
        };
        self.begins_again = false;
        row.group = self.group(groups);
        self.rows += 1;
        if let Some(index) = self.breath {
            let cell = self.line.get(index).unwrap_or_default();
            row.next_breath = self.breaths.begins(cell);
            if self.breaths.are_shuffled(self.rows) {
                let path = self.path.clone();
                return Err(DatasetError::Returns { path, breath: text::name(cell) });
            }
        }
        Ok(Some(row))
    }

    fn disorder(&self) -> Disorder {
        Disorder { heads: self.heads, ..Disorder::default() }
    }
}

/// The numbers of breaths, as the breath column has them.
#[derive(Debug, Default)]
struct Breaths {
    last: Option<Vec<u8>>,
    /// Hashes of all numbers of the group.
    seen: HashSet<u64>,
    hasher: RandomState,
    changes: usize,
    returns: usize,
}

impl Breaths {
    /// Whether a row with this number begins a breath.
    fn begins(&mut self, number: &[u8]) -> bool {
        if self.last.as_deref() == Some(number) {
            return false;
        }
        self.last = Some(number.to_vec());
        self.changes += 1;
        self.returns += usize::from(!self.seen.insert(self.hasher.hash_one(number)));
        true
    }

    /// Another group may have the same numbers.
    fn forget(&mut self) {
        self.seen.clear();
        self.last = None;
    }

    /// Whether breaths come back after a few rows again and again: the rows are in random order.
    fn are_shuffled(&self, rows: usize) -> bool {
        rows >= ORDER_ROWS && rows < BREATH_ROWS * self.changes && 2 * self.returns > self.changes
    }
}
