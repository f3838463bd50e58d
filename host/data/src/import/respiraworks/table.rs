//! The measured tables as text: header, cells, and the rows of one test at a time.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::recording::DatasetError;

/// One row of a table, in the units of a recording.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sample {
    pub(super) time_s: f64,
    pub(super) compliance: f32,
    pub(super) resistance: f32,
    pub(super) setpoint: f32,
    pub(super) pressure: f32,
    /// Flows, L/s.
    pub(super) flow_in: f32,
    pub(super) flow_out: f32,
    /// Valve commands, percent.
    pub(super) inhale: f32,
    pub(super) exhale: f32,
    pub(super) psol: f32,
}

/// Names of the columns, in the order in which [`Table`] counts them.
const COLUMNS: [&str; 12] = [
    "run",
    "test",
    "t_s",
    "C_ml_per_cmH2O",
    "R_cmH2O_per_Lps",
    "setpoint_cmH2O",
    "pressure_cmH2O",
    "flow_in_mlps",
    "flow_out_mlps",
    "cmd_inh_valve",
    "cmd_exh_valve",
    "cmd_psol",
];

/// A command may lie this far outside 0..1, by rounding.
const COMMAND_SLACK: f64 = 1e-3;
const ML_PER_L: f64 = 1000.0;

/// An open table.
pub(super) struct Table {
    path: PathBuf,
    reader: csv::Reader<File>,
    /// Place of each of [`COLUMNS`] in a line.
    at: [usize; 12],
    line: StringRecord,
    /// Whether `line` holds the first row of the next test.
    pending: bool,
}

impl Table {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        let file = File::open(path).map_err(|source| match source.kind() {
            ErrorKind::NotFound => DatasetError::Missing { path: path.to_owned() },
            _ => DatasetError::Read { path: path.to_owned(), source },
        })?;
        let mut reader = csv::Reader::from_reader(file);
        let line_error = |source| DatasetError::TableLine { path: path.to_owned(), source };
        let header = reader.headers().map_err(line_error)?.clone();
        let mut at = [0; COLUMNS.len()];
        for (place, column) in at.iter_mut().zip(COLUMNS) {
            *place = header
                .iter()
                .position(|name| name.trim() == column)
                .ok_or_else(|| DatasetError::TableColumn { path: path.to_owned(), column })?;
        }
        Ok(Self { path: path.to_owned(), reader, at, line: StringRecord::new(), pending: false })
    }

    /// Name and rows of the next test, `None` at the end of the table.
    pub(super) fn next_test(&mut self) -> Result<Option<(String, Vec<Sample>)>, DatasetError> {
        if !self.pending && !self.read_line()? {
            return Ok(None);
        }
        let name = self.test_name();
        let mut samples = Vec::new();
        loop {
            samples.push(self.sample()?);
            self.pending = self.read_line()?;
            if !self.pending || self.test_name() != name {
                return Ok(Some((name, samples)));
            }
        }
    }

    fn read_line(&mut self) -> Result<bool, DatasetError> {
        self.reader
            .read_record(&mut self.line)
            .map_err(|source| DatasetError::TableLine { path: self.path.clone(), source })
    }

    fn cell(&self, column: usize) -> &str {
        self.line.get(self.at[column]).unwrap_or("").trim()
    }

    fn test_name(&self) -> String {
        format!("{}:{}", self.cell(0), self.cell(1))
    }

    fn sample(&self) -> Result<Sample, DatasetError> {
        Ok(Sample {
            time_s: self.number(2)?,
            compliance: self.number(3)? as f32,
            resistance: self.number(4)? as f32,
            setpoint: self.number(5)? as f32,
            pressure: self.number(6)? as f32,
            flow_in: (self.number(7)? / ML_PER_L) as f32,
            flow_out: (self.number(8)? / ML_PER_L) as f32,
            inhale: self.command(9)?,
            exhale: self.command(10)?,
            psol: self.command(11)?,
        })
    }

    fn number(&self, column: usize) -> Result<f64, DatasetError> {
        match self.cell(column).parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(_) => Err(self.bad_cell(column, "is not finite")),
            Err(_) => Err(self.bad_cell(column, "is not a number")),
        }
    }

    /// A command from 0 to 1 as percent.
    fn command(&self, column: usize) -> Result<f32, DatasetError> {
        let command = self.number(column)?;
        if !(-COMMAND_SLACK..=1.0 + COMMAND_SLACK).contains(&command) {
            return Err(self.bad_cell(column, "is not a command from 0 to 1"));
        }
        // The tables write a closed valve as -0.0 too.
        Ok((100.0 * command.clamp(0.0, 1.0) + 0.0) as f32)
    }

    fn bad_cell(&self, column: usize, reason: &'static str) -> DatasetError {
        DatasetError::Cell {
            path: self.path.clone(),
            line: self.line.position().map_or(0, csv::Position::line),
            column: COLUMNS[column],
            value: self.cell(column).to_owned(),
            reason,
        }
    }
}
