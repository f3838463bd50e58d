//! What can be wrong with a recording, and what to do about it.

use std::path::PathBuf;

use thiserror::Error;

/// Why a recording cannot be used, read, written or imported.
#[derive(Debug, Error)]
pub enum DatasetError {
    /// There is no such file.
    #[error("no file {path}: check the path, or record one first")]
    Missing {
        /// The file asked for.
        path: PathBuf,
    },
    /// The operating system refused to read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file asked for.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The operating system refused to write.
    #[error("cannot write {path}: {source}; an older file of that name is unchanged")]
    Write {
        /// The file to be written.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Not a Parquet file at all.
    #[error("{path} is not a Parquet file: give a recording made by this program")]
    NotParquet {
        /// The file asked for.
        path: PathBuf,
    },
    /// A Parquet file that ends early or is damaged inside.
    #[error("{path} is torn or damaged ({detail}): copy it again or record anew")]
    Torn {
        /// The file asked for.
        path: PathBuf,
        /// What the decoder tripped over.
        detail: String,
    },
    /// The encoder failed.
    #[error("cannot encode the recording for {path}: {detail}")]
    Encode {
        /// The file to be written.
        path: PathBuf,
        /// The encoder's reason.
        detail: String,
    },
    /// A required column is not in the file.
    #[error("{path} has no column `{column}`: it is not a complete recording")]
    MissingColumn {
        /// The file asked for.
        path: PathBuf,
        /// The absent column.
        column: &'static str,
    },
    /// A column holds another type of number.
    #[error("{path}: column `{column}` is {found}, expected {expected}: convert it before saving")]
    WrongType {
        /// The file asked for.
        path: PathBuf,
        /// The column.
        column: &'static str,
        /// The type it must have.
        expected: String,
        /// The type it has.
        found: String,
    },
    /// A cell is empty.
    #[error("{path}: column `{column}` is empty in {nulls} rows: fill or remove those rows")]
    Null {
        /// The file asked for.
        path: PathBuf,
        /// The column.
        column: &'static str,
        /// How many cells are empty.
        nulls: usize,
    },
    /// The metadata does not say where the data come from.
    #[error(
        "{path} carries no provenance (metadata key `eupnea`): tools that rewrite Parquet drop it, use the original"
    )]
    NoProvenance {
        /// The file asked for.
        path: PathBuf,
    },
    /// The provenance does not parse.
    #[error("{path} carries a provenance that cannot be read ({source}): use the original file")]
    BadProvenance {
        /// The file asked for.
        path: PathBuf,
        /// The parser's reason.
        source: serde_json::Error,
    },
    /// Written by another version of the program.
    #[error("{path} has recording format {found}, this program reads {expected}: use the matching version")]
    Format {
        /// The file asked for.
        path: PathBuf,
        /// The version in the file.
        found: u32,
        /// The version that can be read.
        expected: u32,
    },
    /// The content of a file breaks a rule of [`super::Recording::validate`].
    #[error("{path}: {source}")]
    Invalid {
        /// The file asked for.
        path: PathBuf,
        /// The broken rule.
        source: Box<DatasetError>,
    },
    /// Columns differ in length.
    #[error("column `{column}` has {rows} rows where `breath` has {expected}: push whole rows only")]
    Length {
        /// The odd column.
        column: &'static str,
        /// Its length.
        rows: usize,
        /// The length it must have.
        expected: usize,
    },
    /// A value is NaN or infinite, or was never given.
    #[error("column `{column}` is {value} in row {row} (counted from 0): repair or drop that breath")]
    NotFinite {
        /// The column.
        column: &'static str,
        /// The first such row.
        row: usize,
        /// The value found.
        value: f32,
    },
    /// Breath or tick numbers do not grow.
    #[error("row {row} (counted from 0) is out of order: breath and tick must grow from row to row")]
    Order {
        /// The first row out of order.
        row: usize,
    },
    /// A whole number outside its range.
    #[error("column `{column}` is {value} in row {row} (counted from 0), must be below {limit}")]
    OutOfRange {
        /// The column.
        column: &'static str,
        /// The first such row.
        row: usize,
        /// The value found.
        value: u32,
        /// The first value that is too large.
        limit: usize,
    },
    /// Two recordings cannot be joined.
    #[error("cannot append: the recordings differ in {what}")]
    Different {
        /// Which property differs.
        what: &'static str,
    },
    /// A line of a table cannot be split into cells.
    #[error("{path}: {source}: correct or remove that line")]
    TableLine {
        /// The table.
        path: PathBuf,
        /// The reader's reason, with the line.
        source: csv::Error,
    },
    /// A table lacks a column that its column map names.
    #[error("{path} has no column `{column}`: correct the column map, or the head of the table")]
    TableColumn {
        /// The table.
        path: PathBuf,
        /// The absent column.
        column: String,
    },
    /// A cell of a table with a column map cannot be used.
    #[error(
        "{path}, line {line}, column `{column}`: `{value}` {reason}: correct the cell or remove the line"
    )]
    TableCell {
        /// The table.
        path: PathBuf,
        /// Line in the file, counted from 1.
        line: u64,
        /// Column of the table.
        column: String,
        /// The text found.
        value: String,
        /// Why it cannot be used.
        reason: &'static str,
    },
    /// Nothing says how fast rows follow.
    #[error(
        "{path}: time does not grow from row to row: check the column and unit of [time] in the column map"
    )]
    NoPeriod {
        /// The table.
        path: PathBuf,
    },
    /// A table is sampled at another rate than the first.
    #[error("{path}: sample period {found_us} us, the first table's {expected_us} us: import them apart")]
    Period {
        /// The table.
        path: PathBuf,
        /// Its period, microseconds.
        found_us: u32,
        /// Period of the first table, microseconds.
        expected_us: u32,
    },
    /// Nothing usable in the tables.
    #[error("no breath found in {tables} tables: nothing in them starts one")]
    NoBreath {
        /// How many tables were read.
        tables: usize,
    },
}
