//! Recordings of a SERVO-U: `[REC]`, settings in the language of the ventilator, `[DATA]`, the names of the columns with their units, and
//! rows of time of day, phase, pressure, flow, volume and, in some rows, trigger. Tabs stand between the cells, or what a spreadsheet made
//! of them. A file may have several recordings.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::lines::Lines;
use super::map::{Decimal, QUANTITIES, Quantity, TableLayout};
use super::propose::words::{Meaning, bracketed, unit};
use super::rows::{RowSource, TableRow};
use super::table::cells::{Clock, number};
use super::table::text::name;
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// First line of a recording, and the one before its table.
const BEGIN: &str = "[REC]";
const DATA: &str = "[DATA]";
/// Places of the columns.
const TIME: usize = 0;
const PRESSURE: usize = 2;
const FLOW: usize = 3;
const VOLUME: usize = 4;
/// Factor of a flow in L/min, its usual unit, to L/s.
const LITRES_A_MINUTE: f64 = 1.0 / 60.0;
const NOTE: &str = "SERVO-U: no valve commands and no set-point are recorded, u_in is 0";

/// What the files have.
pub(super) fn layout() -> TableLayout {
    let has = |quantity| {
        matches!(quantity, Quantity::Time | Quantity::Pressure | Quantity::FlowIn | Quantity::FlowOut)
    };
    TableLayout::of_format("SERVO-U", NOTE, has)
}

/// Whether a file with this first line is a recording.
pub(super) fn is_recording(first: &str) -> bool {
    first.starts_with(BEGIN)
}

/// Whether a file with this first line is something else of a SERVO-U, such as its trends.
pub(super) fn is_other(first: &str) -> bool {
    let word = first.strip_prefix('[').is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_uppercase()));
    word && !is_recording(first)
}

/// What the lines are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    Settings,
    Names,
    Rows,
}

/// The rows of a file.
pub(super) struct ServoURows {
    path: PathBuf,
    lines: Lines,
    part: Part,
    separator: char,
    /// Factors of pressure and flow to our units.
    factors: [f64; 2],
    clock: Clock,
    unused: BTreeMap<String, usize>,
}

impl ServoURows {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        Ok(Self {
            path: path.to_owned(),
            lines: Lines::open(path)?,
            part: Part::Settings,
            separator: '\t',
            factors: [1.0, LITRES_A_MINUTE],
            clock: Clock::default(),
            unused: BTreeMap::new(),
        })
    }

    /// Takes the line with the names, which has the units in brackets.
    fn names(&mut self, line: &str) -> Result<(), DatasetError> {
        self.separator = ['\t', ';', ','].into_iter().find(|mark| line.contains(*mark)).unwrap_or('\t');
        let names: Vec<&str> = line.split(self.separator).collect();
        let factor = |place: usize, meaning, usual| {
            let text = names.get(place).and_then(|name| bracketed(name));
            text.map_or(Some(usual), |text| unit(text, meaning).map(|(_, factor)| factor))
        };
        let pressure = factor(PRESSURE, Meaning::Of(Quantity::Pressure), 1.0);
        let flow = factor(FLOW, Meaning::Flow, LITRES_A_MINUTE);
        let (Some(pressure), Some(flow)) = (pressure, flow) else {
            let reason =
                "has a pressure or a flow in an unknown unit, below [DATA]: convert it to cmH2O and l/m";
            return Err(DatasetError::NoTable { path: self.path.clone(), reason });
        };
        self.factors = [pressure, flow];
        Ok(())
    }

    /// The row in a line. One that was cut off lacks the volume.
    fn row(&mut self, line: &str) -> Option<TableRow> {
        let cells: Vec<&str> = line.split(self.separator).map(str::trim).collect();
        let value = |place: usize| number(cells.get(place)?, Decimal::EITHER);
        let (pressure, flow, _) = (value(PRESSURE)?, value(FLOW)?, value(VOLUME)?);
        let time = self.clock.seconds(cells[TIME])?;
        let mut row = TableRow { fields: [0.0; QUANTITIES], next_breath: false, inspires: false, group: 0 };
        row.set(Quantity::Time, time);
        row.set(Quantity::Pressure, pressure * self.factors[0]);
        row.set(Quantity::UIn, f64::NAN);
        row.set_flow(flow * self.factors[1]);
        Some(row)
    }
}

impl RowSource for ServoURows {
    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let group = self.lines.group(groups);
        while let Some(line) = self.lines.next()? {
            let line = name(line);
            match self.part {
                _ if line.starts_with(BEGIN) => {
                    (self.part, self.clock) = (Part::Settings, Clock::default());
                }
                Part::Settings if line.starts_with(DATA) => self.part = Part::Names,
                Part::Settings => {}
                Part::Names => {
                    self.names(&line)?;
                    self.part = Part::Rows;
                }
                Part::Rows => match self.row(&line) {
                    Some(row) => return Ok(Some(TableRow { group, ..row })),
                    None => *self.unused.entry("incomplete lines".to_owned()).or_default() += 1,
                },
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
