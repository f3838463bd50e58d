//! The rows of a file, whatever its format: what the assembler of breaths takes.

use std::collections::BTreeMap;

use serde::Serialize;

use super::map::{QUANTITIES, Quantity};
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// One value per [`Quantity`], in its order and in our units.
pub type Fields = [f64; QUANTITIES];

/// A row of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableRow {
    /// Values; 0 for quantities that the table does not have, NaN for a command that is not known.
    pub fields: Fields,
    /// Whether the breath column's value differs from the previous row's.
    pub next_breath: bool,
    /// Whether the patient inhales, where the file tells or [`super::inspirations`] has found it.
    pub inspires: bool,
    /// Index of the group.
    pub group: u32,
}

impl TableRow {
    /// The value of a quantity.
    pub fn get(&self, quantity: Quantity) -> f64 {
        self.fields[quantity as usize]
    }

    /// Sets the value of a quantity.
    pub fn set(&mut self, quantity: Quantity, value: f64) {
        self.fields[quantity as usize] = value;
    }

    /// Whether the expiratory valve is open.
    pub fn opens_out(&self) -> bool {
        self.get(Quantity::UOut) >= OPEN
    }

    /// Net flow into the lung, L/s.
    pub fn flow(&self) -> f64 {
        self.get(Quantity::FlowIn) - self.get(Quantity::FlowOut)
    }

    /// Sets both flows from one that is positive into the lung, L/s.
    pub fn set_flow(&mut self, flow: f64) {
        self.set(Quantity::FlowIn, flow.max(0.0));
        self.set(Quantity::FlowOut, (-flow).max(0.0));
    }
}

/// What is wrong with a file without rows.
pub(super) const NO_ROWS: &str = "has no rows, or none that can be read: check its format";
/// Position of the expiratory valve from which it counts as open, percent.
const OPEN: f64 = 50.0;
/// Longest step between consecutive rows, in periods; with a longer one, rows are missing.
const MOST_PERIODS: f64 = 1.75;
/// Longest step whose missing rows are filled, in periods and seconds; a longer one is a gap.
const FILLED: (f64, f64) = (5.0, 0.061);

/// What lies between two rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Between {
    /// About a period.
    Nothing,
    /// A few rows are missing: they are filled.
    FewRows,
    /// A gap in time, or a clock that was set back.
    Gap,
}

impl Between {
    pub(super) fn of(last: &TableRow, next: &TableRow, period_s: f64) -> Self {
        let step = next.get(Quantity::Time) - last.get(Quantity::Time);
        if step > 0.0 && step <= MOST_PERIODS * period_s {
            Self::Nothing
        } else if step > 0.0 && step <= (FILLED.0 * period_s).min(FILLED.1) {
            Self::FewRows
        } else {
            Self::Gap
        }
    }
}

/// What became of rows that were read but are not in the recording, or not where they were.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Disorder {
    /// Rows that equal the one before, time included.
    pub repeated: usize,
    /// Rows at a time at which another one, with other values, came first.
    pub same_time: usize,
    /// Rows put in the order of their times.
    pub reordered: usize,
    /// Rows too late for that.
    pub late: usize,
    /// Lines between the names and the first row, such as units.
    pub heads: usize,
}

impl Disorder {
    /// Adds what another table had.
    pub(super) fn add(&mut self, other: Self) {
        self.repeated += other.repeated;
        self.same_time += other.same_time;
        self.reordered += other.reordered;
        self.late += other.late;
        self.heads += other.heads;
    }

    /// Rows that were left out.
    pub(super) fn dropped(self) -> usize {
        self.repeated + self.same_time + self.late
    }
}

/// A file of which rows are read in their order.
pub(super) trait RowSource {
    /// The next row; `None` at the end. New names are added to `groups`.
    ///
    /// # Errors
    /// Content that cannot be used, with its line.
    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError>;

    /// Number of bytes of the file read so far.
    fn position(&self) -> u64;

    /// Number of events that no row uses, by name.
    fn unused(&self) -> BTreeMap<String, usize> {
        BTreeMap::new()
    }

    /// What was wrong with the rows' order.
    fn disorder(&self) -> Disorder {
        Disorder::default()
    }
}

/// Index of a group, which is added if it is new.
pub(super) fn index_of(groups: &mut Vec<TestRun>, run: TestRun) -> u32 {
    let known = groups.iter().position(|group| *group == run);
    known.unwrap_or_else(|| {
        groups.push(run);
        groups.len() - 1
    }) as u32
}
