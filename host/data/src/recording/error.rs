//! Errors of recordings, and how to resolve them.

use std::path::PathBuf;

use thiserror::Error;

/// Why a recording cannot be used, read, written or imported.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum DatasetError {
    /// The file does not exist.
    #[error("{0} does not exist: check the path, or record one first")]
    Missing(PathBuf),
    /// The operating system could not read the file.
    #[error("cannot read {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// The operating system could not write the file.
    #[error("cannot write {path}: {source}; an existing file of that name is unchanged")]
    Write { path: PathBuf, source: std::io::Error },
    /// Not a Parquet file.
    #[error("{0} is not a Parquet file: give a recording made by this program")]
    NotParquet(PathBuf),
    /// An incomplete or damaged Parquet file.
    #[error("{path} is incomplete or damaged ({detail}): copy or record it again")]
    Torn { path: PathBuf, detail: String },
    /// The encoder failed.
    #[error("cannot encode the recording for {path}: {detail}")]
    Encode { path: PathBuf, detail: String },
    /// A required column is not in the file.
    #[error("{path} has no column `{column}`: it is not a complete recording")]
    MissingColumn { path: PathBuf, column: &'static str },
    /// A column contains another type of number.
    #[error("{path}: column `{column}` is {found}, expected {expected}: convert it before saving")]
    WrongType { path: PathBuf, column: &'static str, expected: String, found: String },
    /// A cell is empty.
    #[error("{path}: column `{column}` is empty in {nulls} rows: fill or remove those rows")]
    Null { path: PathBuf, column: &'static str, nulls: usize },
    /// The metadata has no provenance.
    #[error(
        "{0} has no provenance (metadata key `eupnea`), perhaps because a tool rewrote it: use the original file"
    )]
    NoProvenance(PathBuf),
    /// The provenance cannot be parsed.
    #[error("{path} has a provenance that cannot be read ({source}): use the original file")]
    BadProvenance { path: PathBuf, source: serde_json::Error },
    /// Written by another version of the program.
    #[error("{path} has recording format {found}, but this program reads {expected}: use a matching version")]
    Format { path: PathBuf, found: u32, expected: u32 },
    /// The content of a file violates a rule of [`super::Recording::validate`].
    #[error("{path}: {source}")]
    Invalid { path: PathBuf, source: Box<DatasetError> },
    /// Columns differ in length.
    #[error("column `{column}` has {rows} rows where `breath` has {expected}: push whole rows only")]
    Length { column: &'static str, rows: usize, expected: usize },
    /// A value is NaN, infinite or missing.
    #[error("column `{column}` is {value} in row {row} (counted from 0): correct or remove that breath")]
    NotFinite { column: &'static str, row: usize, value: f32 },
    /// Breath or tick numbers do not increase.
    #[error("row {0} (counted from 0) is out of order: breath and tick must increase from row to row")]
    Order(usize),
    /// A whole number outside its range.
    #[error("column `{column}` is {value} in row {row} (counted from 0), but must be below {limit}")]
    OutOfRange { column: &'static str, row: usize, value: u32, limit: usize },
    /// Two recordings cannot be joined.
    #[error("cannot append: the recordings differ in {0}")]
    Different(&'static str),
    /// A line of a table cannot be split into cells.
    #[error("{path}, line {line}: {reason}: correct or remove that line")]
    TableLine { path: PathBuf, line: u64, reason: String },
    /// A file is no table that can be read.
    #[error("{path} {reason}")]
    NoTable { path: PathBuf, reason: &'static str },
    /// A table lacks a column named in the column map.
    #[error("{path} has no column `{column}`; its first line has {found}: correct {correct}")]
    TableColumn { path: PathBuf, column: String, found: String, correct: &'static str },
    /// A name of the column map is that of several columns.
    #[error("{path} has several columns `{column}`: rename all but the one that is meant")]
    TableColumns { path: PathBuf, column: String },
    /// A cell of a table with a column map cannot be used.
    #[error("{path}, line {line}, column `{column}`: `{value}` {reason}")]
    TableCell { path: PathBuf, line: u64, column: String, value: String, reason: &'static str },
    /// A file was written to while it was read.
    #[error(
        "{0} changed while it was read: wait until it is complete, or import a copy; nothing was written"
    )]
    Changed(PathBuf),
    /// Most rows of a table are out of order.
    #[error("{path}: time runs backwards in {backwards} of {rows} rows: sort the rows by their times first")]
    Shuffled { path: PathBuf, backwards: usize, rows: usize },
    /// The breaths of a table come back after a few rows.
    #[error(
        "{path}: breath `{breath}` and others come back again and again: sort the rows by breath and time first"
    )]
    Returns { path: PathBuf, breath: String },
    /// The time stands still.
    #[error(
        "{path}: the time stands still in {same} of {rows} rows: name a finer column, or leave [time] out and give period_ms"
    )]
    SameTime { path: PathBuf, same: usize, rows: usize },
    /// A line of a PIRDS file is not an event.
    #[error("{path}, line {line}: {reason}")]
    EventLine { path: PathBuf, line: u64, reason: String },
    /// The events of a PIRDS file do not make a recording.
    #[error("{path}: {reason}")]
    Events { path: PathBuf, reason: &'static str },
    /// The sample period cannot be determined.
    #[error("{0}: time does not increase from row to row: check column and unit of [time] in the column map")]
    NoPeriod(PathBuf),
    /// A table's sample period differs from the first one's.
    #[error("{path}: sample period {found_us} us, first table {expected_us} us: import them separately")]
    Period { path: PathBuf, found_us: u32, expected_us: u32 },
    /// The user asked to stop.
    #[error(
        "stopped before the recording was complete: nothing was written, an existing file of that name is unchanged"
    )]
    Stopped,
    /// The tables contain no breath.
    #[error(
        "no start of a breath found in {rows} rows of {seconds:.1} s: check the unit of [time], and which columns show the breaths"
    )]
    NoBreath { rows: usize, seconds: f64 },
    /// There is no table.
    #[error("name at least one table")]
    NoTables,
}
