//! Files of the waveforms of a Puritan Bennett 840: for each breath a line `BS, S:` with its number, lines of flow (L/min) and pressure
//! (cmH2O) at 50 Hz, and a line `BE`. Lines with a date may stand between them, or dates before the values.

use std::collections::BTreeMap;
use std::path::Path;

use super::lines::Lines;
use super::map::{Decimal, QUANTITIES, Quantity, StartBy, TableLayout};
use super::rows::{RowSource, TableRow};
use super::table::cells::number;
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// What separates the cells: commas, or what a spreadsheet made of them.
const SEPARATORS: [char; 3] = [',', ';', '\t'];
/// Period of the rows, s.
const PERIOD_S: f64 = 0.02;
/// Marks of the start and the end of a breath, and what its number follows.
const BEGIN: &str = "BS";
const END: &str = "BE";
const NUMBER: &str = "S:";
/// Litres per minute in a litre per second.
const PER_LITRE_PER_SECOND: f64 = 60.0;
/// Values beyond those of any ventilator, L/min and cmH2O.
const MOST: (f64, f64) = (300.0, 200.0);
const NOTE: &str = "Puritan Bennett 840: no valve commands and no set-point are recorded, u_in is 0";

/// What the files have.
pub(super) fn layout() -> TableLayout {
    let has = |quantity| {
        matches!(quantity, Quantity::Time | Quantity::Pressure | Quantity::FlowIn | Quantity::FlowOut)
    };
    TableLayout {
        period_s: Some(PERIOD_S),
        start: StartBy::Number,
        ..TableLayout::of_format("Puritan Bennett 840", NOTE, has)
    }
}

/// Whether a line begins a breath.
pub(super) fn begins_breath(line: &str) -> bool {
    line.split(SEPARATORS).any(|cell| cell.trim() == BEGIN)
}

/// Whether a cell of a line is a mark, before which may be what is left of a line that was cut off.
fn has(line: &str, mark: &str) -> bool {
    line.split(SEPARATORS).any(|cell| cell.trim_end().ends_with(mark))
}

/// The rows of a file.
pub(super) struct Pb840Rows {
    lines: Lines,
    time_s: f64,
    /// Number of the running breath; none between two.
    breath: Option<u64>,
    last_breath: Option<u64>,
    begins: bool,
    unused: BTreeMap<String, usize>,
}

impl Pb840Rows {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        Ok(Self {
            lines: Lines::open(path)?,
            time_s: 0.0,
            breath: None,
            last_breath: None,
            begins: false,
            unused: BTreeMap::new(),
        })
    }

    fn count(&mut self, name: &str) {
        *self.unused.entry(name.to_owned()).or_default() += 1;
    }

    /// Takes the line that begins a breath. A number higher than the next one shows that breaths are missing.
    fn begin(&mut self, line: &str) {
        let number = line.split_once(NUMBER).and_then(|(_, number)| {
            number.split(SEPARATORS).next().unwrap_or_default().trim().parse::<u64>().ok()
        });
        let Some(number) = number else {
            self.breath = None;
            self.count("breaths without a number");
            return;
        };
        let missing = self.last_breath.map_or(0, |last| number.saturating_sub(last + 1));
        if missing > 0 {
            *self.unused.entry("missing breaths".to_owned()).or_default() += missing as usize;
        }
        (self.breath, self.last_breath, self.begins) = (Some(number), Some(number), true);
    }

    /// The row in a line of values.
    fn row(&mut self, line: &str) -> Option<TableRow> {
        // Beside other separators a comma is a decimal one.
        let separators = if line.contains(&SEPARATORS[1..]) { &SEPARATORS[1..] } else { &SEPARATORS };
        let line = line.trim_end_matches(|c: char| c.is_whitespace() || separators.contains(&c));
        let mut cells = line.rsplit(separators).map(|cell| number(cell.trim(), Decimal::EITHER));
        let (pressure, flow) = (cells.next()??, cells.next()??);
        if !(flow.abs() <= MOST.0 && pressure.abs() <= MOST.1) {
            return None;
        }
        let next_breath = std::mem::take(&mut self.begins);
        let mut row = TableRow { fields: [0.0; QUANTITIES], next_breath, inspires: false, group: 0 };
        row.set(Quantity::Time, self.time_s);
        row.set(Quantity::Pressure, pressure);
        row.set(Quantity::UIn, f64::NAN);
        row.set_flow(flow / PER_LITRE_PER_SECOND);
        Some(row)
    }
}

impl RowSource for Pb840Rows {
    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let group = self.lines.group(groups);
        while let Some(line) = self.lines.next()? {
            let line = String::from_utf8_lossy(line).into_owned();
            if has(&line, BEGIN) {
                self.begin(&line);
            } else if has(&line, END) {
                self.breath = None;
            } else if self.breath.is_none() {
                self.count("lines outside of breaths");
            } else if let Some(row) = self.row(&line) {
                self.time_s += PERIOD_S;
                return Ok(Some(TableRow { group, ..row }));
            } else {
                self.time_s += PERIOD_S;
                self.count("lines without flow and pressure");
            }
        }
        Ok(None)
    }

    fn position(&self) -> u64 {
        self.lines.position()
    }

    fn unused(&self) -> BTreeMap<String, usize> {
        self.unused.clone()
    }
}
