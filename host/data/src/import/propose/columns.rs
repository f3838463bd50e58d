//! The columns of a table of which nothing is known: separator, names, units and first rows.

use std::collections::BTreeMap;

use super::super::map::Decimal;
use super::super::table::cells::{Clock, number};

/// Separators that are tried; of those that part the lines alike the first.
const SEPARATORS: [char; 5] = [';', '\t', ',', '|', ' '];
/// Lines among which the names are sought.
const HEADS: usize = 200;
/// Rows that are judged.
const ROWS: usize = 2000;
/// What a commented line begins with.
const COMMENT: char = '#';
/// Words before a sample rate in Hz.
const RATES: [&str; 4] = ["samplerate", "sample rate", "sampling rate", "sample_rate"];

/// The columns of a table.
pub(super) struct Columns {
    pub separator: char,
    pub decimal: Decimal,
    /// Names; empty if the first line has numbers.
    pub names: Vec<String>,
    /// Words of the line below the names, if that is no row.
    pub units: Vec<String>,
    /// The cells of the first rows.
    rows: Vec<Vec<String>>,
    /// Sample rate that a line above the table tells, Hz.
    pub rate: Option<f64>,
}

impl Columns {
    /// The columns with the separator that parts most lines alike; otherwise what is wrong.
    pub fn of(lines: &[String]) -> Result<Self, &'static str> {
        // The one that is listed first, of equally good ones.
        let parted = SEPARATORS.map(|separator| (separator, parted(lines, separator)));
        let best = parted.into_iter().rev().max_by_key(|(_, (_, rows))| *rows);
        let (separator, cells) = match best {
            Some((separator, (cells, rows))) if rows > 0 => (separator, cells),
            _ => return Err("has no columns: no separator parts its lines alike"),
        };
        let decimal = if separator == ',' { Decimal { mark: b'.', sure: false } } else { Decimal::EITHER };
        let table: Vec<Vec<String>> = lines.iter().map(|line| split(line, separator)).collect();
        let is_row = |line: &Vec<String>| line.len() == cells && has_values(line, decimal);
        let first = table.iter().take(HEADS).position(is_row);
        let first = first.ok_or("has no rows of numbers: give columns of plain numbers, without units")?;
        let heads = heads(&table[..first], cells);
        let mut names = heads.first().map_or_else(Vec::new, |names| (*names).clone());
        if let Some(first) = names.first_mut() {
            *first = first.trim_start_matches(COMMENT).trim().to_owned();
        }
        let rows: Vec<Vec<String>> =
            table[first..].iter().filter(|line| is_row(line)).take(ROWS).cloned().collect();
        let has_comma = |cell: &String| cell.contains(',') && number(cell, Decimal::EITHER).is_some();
        let sure = separator != ',' && rows.iter().flatten().any(has_comma);
        Ok(Self {
            separator,
            decimal: Decimal { sure, ..decimal },
            units: heads.get(1).map_or_else(Vec::new, |units| (*units).clone()),
            names,
            rows,
            rate: lines[..first].iter().find_map(|line| rate(line)),
        })
    }

    /// Number of columns.
    pub fn count(&self) -> usize {
        self.rows.first().map_or(0, Vec::len)
    }

    /// The numbers of a column; times of day in seconds.
    pub fn values(&self, column: usize) -> Vec<f64> {
        let mut clock = Clock::default();
        let cells = self.rows.iter().filter_map(|row| row.get(column));
        cells.filter_map(|cell| number(cell, self.decimal).or_else(|| clock.seconds(cell))).collect()
    }

    /// The name of a column, unless it is that of another one too.
    pub fn name(&self, column: usize) -> Option<&str> {
        let name = self.names.get(column).filter(|name| !name.is_empty())?;
        (self.names.iter().filter(|other| *other == name).count() == 1).then_some(name.as_str())
    }
}

/// The lines with names and units among those above the rows: of as many cells as these, if possible not commented out, or else with one
/// cell less, as rows may end with a separator.
fn heads(above: &[Vec<String>], cells: usize) -> Vec<&Vec<String>> {
    let lines = |cells: usize, commented: bool| -> Vec<&Vec<String>> {
        let fits = |line: &&Vec<String>| line.len() == cells && line[0].starts_with(COMMENT) == commented;
        above.iter().filter(fits).collect()
    };
    let mut kinds = [lines(cells, false), lines(cells, true), lines(cells.max(3) - 1, false)].into_iter();
    kinds.find(|lines| !lines.is_empty()).unwrap_or_default()
}

/// How many cells most lines have with a separator, and how many lines.
fn parted(lines: &[String], separator: char) -> (usize, usize) {
    let mut counts = BTreeMap::<usize, usize>::new();
    for line in lines.iter().filter(|line| !line.is_empty()) {
        *counts.entry(split(line, separator).len()).or_default() += 1;
    }
    counts.into_iter().filter(|(cells, _)| *cells > 1).max_by_key(|(_, rows)| *rows).unwrap_or((1, 0))
}

/// The cells of a line; in quotes, a separator is part of a cell.
fn split(line: &str, separator: char) -> Vec<String> {
    let mut quoted = false;
    let cells = line.split(|letter| {
        quoted ^= letter == '"';
        letter == separator && !quoted
    });
    cells.map(|cell| cell.trim().trim_matches('"').trim().to_owned()).collect()
}

/// Whether a line has numbers or times in most of the cells that are not empty.
fn has_values(cells: &[String], decimal: Decimal) -> bool {
    let is_value =
        |cell: &&String| number(cell, decimal).is_some() || Clock::default().seconds(cell).is_some();
    let values = cells.iter().filter(is_value).count();
    values > 0 && values * 2 > cells.iter().filter(|cell| !cell.is_empty()).count()
}

/// The sample rate that a line tells.
fn rate(line: &str) -> Option<f64> {
    let lower = line.to_lowercase();
    let (_, rest) = RATES.iter().find_map(|word| lower.split_once(word))?;
    let digits = rest.trim_start_matches(|letter: char| !letter.is_ascii_digit());
    let end = digits.find(|letter: char| !letter.is_ascii_digit() && letter != '.').unwrap_or(digits.len());
    digits[..end].parse().ok().filter(|rate| *rate > 0.0)
}
