//! Finds the line with the names of a table's columns, whatever stands before it.

use std::io::Read;
use std::path::Path;

use csv::ByteRecord;

use super::super::map::{Column, TableLayout};
use super::text::name;
use crate::recording::DatasetError;

/// Bytes of a file in which its names must be.
const HEAD: u64 = 1 << 16;
/// Number of names that an error shows.
const NAMES: usize = 8;

/// The start of a table.
#[derive(Debug)]
pub(super) struct Header {
    /// Names of the columns; empty if the table has none.
    pub names: Vec<String>,
    /// Number of lines up to and with that of the names.
    pub lines: u64,
    /// What has been read beyond that line.
    pub rest: Vec<u8>,
}

impl Header {
    /// Reads the start of a table: the first line that has all names of the layout, or no line if it has numbers instead.
    pub fn read(path: &Path, text: &mut dyn Read, layout: &TableLayout) -> Result<Self, DatasetError> {
        let mut head = Vec::new();
        let read = |source| DatasetError::Read { path: path.to_owned(), source };
        text.take(HEAD).read_to_end(&mut head).map_err(read)?;
        let wanted: Vec<&str> = layout.columns().filter_map(Column::name).collect();
        let mut begin = 0;
        let mut first = None;
        for (line, text) in (1_u64..).zip(head.split_inclusive(|byte| *byte == b'\n')) {
            let end = begin + text.len();
            if line <= layout.skip_lines || text.trim_ascii().is_empty() {
                begin = end;
                continue;
            }
            let names = split(text, layout);
            if wanted.is_empty() {
                return Ok(Self { names: Vec::new(), lines: line - 1, rest: head.split_off(begin) });
            }
            if wanted.iter().all(|wanted| names.iter().any(|name| name == wanted)) {
                return Ok(Self { names, lines: line, rest: head.split_off(end) });
            }
            if first.is_none() && Some(text[0]) != layout.comment {
                first = Some(names);
            }
            begin = end;
        }
        Err(lacking(path, &first.unwrap_or_default(), &wanted))
    }

    /// Index of a column.
    pub fn index(&self, path: &Path, column: &Column) -> Result<usize, DatasetError> {
        let name = match column {
            Column::Number(number) => return Ok(number - 1),
            Column::Name(name) => name,
        };
        let mut found = self.names.iter().enumerate().filter(|(_, known)| *known == name);
        match (found.next(), found.next()) {
            (Some((index, _)), None) => Ok(index),
            (Some(_), Some(_)) => {
                Err(DatasetError::TableColumns { path: path.to_owned(), column: name.clone() })
            }
            (None, _) => Err(lacking(path, &self.names, &[name])),
        }
    }
}

/// The names in a line, which may be commented out.
fn split(line: &[u8], layout: &TableLayout) -> Vec<String> {
    let line = match (layout.comment, line.split_first()) {
        (Some(mark), Some((first, rest))) if *first == mark => rest,
        _ => line,
    };
    let mut table =
        csv::ReaderBuilder::new().delimiter(layout.separator).has_headers(false).from_reader(line);
    let mut record = ByteRecord::new();
    // What cannot be split has none of the names.
    let _ = table.read_byte_record(&mut record);
    record.iter().map(name).collect()
}

/// The error for the first name that a line lacks.
fn lacking(path: &Path, names: &[String], wanted: &[&str]) -> DatasetError {
    let missing = wanted.iter().find(|wanted| !names.iter().any(|name| name == *wanted));
    let shown: Vec<_> = names.iter().take(NAMES).map(|name| format!("`{name}`")).collect();
    let rest = if names.len() > NAMES { ", ..." } else { "" };
    DatasetError::TableColumn {
        path: path.to_owned(),
        column: missing.map_or_else(String::new, |missing| (*missing).to_owned()),
        found: shown.join(", ") + rest,
        // A line that was not split has the separator in its only name.
        correct: if names.len() == 1 {
            "the separator in the column map"
        } else {
            "the column map, or that line"
        },
    }
}
