//! What can be wrong with a recording, and what to do about it.

use std::path::PathBuf;

use thiserror::Error;

/// Why a recording cannot be used, read, written or imported.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum DatasetError {
    /// There is no such file.
    #[error("no file {0}: check the path, or record one first")]
    Missing(PathBuf),
    /// The operating system refused to read.
    #[error("cannot read {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// The operating system refused to write.
    #[error("cannot write {path}: {source}; an older file of that name is unchanged")]
    Write { path: PathBuf, source: std::io::Error },
    /// Not a Parquet file at all.
    #[error("{0} is not a Parquet file: give a recording made by this program")]
    NotParquet(PathBuf),
    /// A Parquet file that ends early or is damaged inside.
    #[error("{path} is torn or damaged ({detail}): copy it again or record anew")]
    Torn { path: PathBuf, detail: String },
    /// The encoder failed.
    #[error("cannot encode the recording for {path}: {detail}")]
    Encode { path: PathBuf, detail: String },
    /// A required column is not in the file.
    #[error("{path} has no column `{column}`: it is not a complete recording")]
    MissingColumn { path: PathBuf, column: &'static str },
    /// A column holds another type of number.
    #[error("{path}: column `{column}` is {found}, expected {expected}: convert it before saving")]
    WrongType { path: PathBuf, column: &'static str, expected: String, found: String },
    /// A cell is empty.
    #[error("{path}: column `{column}` is empty in {nulls} rows: fill or remove those rows")]
    Null { path: PathBuf, column: &'static str, nulls: usize },
    /// The metadata does not say where the data come from.
    #[error(
        "{0} carries no provenance (metadata key `eupnea`): tools that rewrite Parquet drop it, use the original"
    )]
    NoProvenance(PathBuf),
    /// The provenance does not parse.
    #[error("{path} carries a provenance that cannot be read ({source}): use the original file")]
    BadProvenance { path: PathBuf, source: serde_json::Error },
    /// Written by another version of the program.
    #[error("{path} has recording format {found}, this program reads {expected}: use the matching version")]
    Format { path: PathBuf, found: u32, expected: u32 },
    /// The content of a file breaks a rule of [`super::Recording::validate`].
    #[error("{path}: {source}")]
    Invalid { path: PathBuf, source: Box<DatasetError> },
    /// Columns differ in length.
    #[error("column `{column}` has {rows} rows where `breath` has {expected}: push whole rows only")]
    Length { column: &'static str, rows: usize, expected: usize },
    /// A value is NaN or infinite, or was never given.
    #[error("column `{column}` is {value} in row {row} (counted from 0): repair or drop that breath")]
    NotFinite { column: &'static str, row: usize, value: f32 },
    /// Breath or tick numbers do not grow.
    #[error("row {0} (counted from 0) is out of order: breath and tick must grow from row to row")]
    Order(usize),
    /// A whole number outside its range.
    #[error("column `{column}` is {value} in row {row} (counted from 0), must be below {limit}")]
    OutOfRange { column: &'static str, row: usize, value: u32, limit: usize },
    /// Two recordings cannot be joined.
    #[error("cannot append: the recordings differ in {0}")]
    Different(&'static str),
    /// A line of a table cannot be split into cells.
    #[error("{path}: {source}: correct or remove that line")]
    TableLine { path: PathBuf, source: csv::Error },
    /// A table lacks a column that its column map names.
    #[error("{path} has no column `{column}`: correct the column map, or the head of the table")]
    TableColumn { path: PathBuf, column: String },
    /// A cell of a table with a column map cannot be used.
    #[error(
        "{path}, line {line}, column `{column}`: `{value}` {reason}: correct the cell or remove the line"
    )]
    TableCell { path: PathBuf, line: u64, column: String, value: String, reason: &'static str },
    /// Nothing says how fast rows follow.
    #[error("{0}: time does not grow from row to row: check the column and unit of [time] in the column map")]
    NoPeriod(PathBuf),
    /// A table is sampled at another rate than the first.
    #[error("{path}: sample period {found_us} us, the first table's {expected_us} us: import them apart")]
    Period { path: PathBuf, found_us: u32, expected_us: u32 },
    /// The caller's progress asked to stop.
    #[error(
        "stopped before the recording was whole: nothing is written, an older file of that name is unchanged"
    )]
    Stopped,
    /// Nothing usable in the tables.
    #[error("no breath found in {0} tables: nothing in them starts one")]
    NoBreath(usize),
}
