//! Finds inspirations where nothing marks them: by the flow or, without one, by the pressure.

use super::map::Quantity;
use super::rows::{Disorder, RowSource, TableRow};
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// Rise of the pressure above its low end from which the patient inhales, cmH2O.
const RISE: f64 = 1.0;
/// Share of the way back from the highest pressure at which that inspiration has ended.
const FALLEN: f64 = 0.2;
/// Share of the high flow, above that of a leak, from which a flow counts as in or out.
const FLOWS: f64 = 0.1;

/// What shows inspirations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum By {
    /// The net flow into the lung, L/s: that of the leak in expirations, and one that few rows exceed.
    Flow {
        /// Flow of the leak.
        leak: f64,
        /// Flow exceeded in few rows.
        high: f64,
    },
    /// The pressure, cmH2O: the one between inspirations.
    Pressure {
        /// Pressure below which few rows are.
        low: f64,
    },
}

/// The running inspiration or expiration.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Inspiration {
    inhales: bool,
    /// Whether an expiration has been seen, without which no breath is known to start.
    exhaled: bool,
    /// Highest pressure of the inspiration, cmH2O.
    peak: f64,
    /// Whether the pressure has come down again since the last inspiration.
    rested: bool,
}

impl Inspiration {
    /// Takes a row's net flow, L/s, and pressure, cmH2O. True at the start of an inspiration.
    pub(super) fn starts(&mut self, by: By, flow: f64, pressure: f64) -> bool {
        match by {
            By::Flow { leak, high } => self.by_flow(flow - leak, FLOWS * (high - leak)),
            By::Pressure { low } => self.by_pressure(pressure, low),
        }
    }

    /// Takes the flow beyond that of a leak; `least` is a magnitude that counts as one.
    fn by_flow(&mut self, flow: f64, least: f64) -> bool {
        self.becomes(if flow.abs() > least { flow > 0.0 } else { self.inhales })
    }

    fn by_pressure(&mut self, pressure: f64, low: f64) -> bool {
        if !self.inhales {
            self.peak = pressure;
            // Half as high, so that noise starts no breath on the way down.
            self.rested |= pressure <= low + 0.5 * RISE;
            return self.becomes(self.rested && pressure > low + RISE);
        }
        self.rested = false;
        self.peak = self.peak.max(pressure);
        self.becomes(pressure >= low + (1.0 - FALLEN) * (self.peak - low))
    }

    fn becomes(&mut self, inhales: bool) -> bool {
        let starts = inhales && !self.inhales && self.exhaled;
        self.inhales = inhales;
        self.exhaled |= !inhales;
        starts
    }
}

/// How the rows of a file show its breaths.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Marks {
    /// The rows have marks of their own.
    Own,
    /// A survey has found the rows at which breaths start.
    Starts(Vec<usize>),
    /// The rows have marks of their own for starts; flow or pressure show ends.
    Phases(By),
    /// Flow or pressure show starts and ends.
    Breaths(By),
}

/// The rows of a source with the starts of breaths and, where only flow or pressure show them, their phases.
#[derive(Debug)]
pub(super) struct Phased<R> {
    source: R,
    marks: Marks,
    inspiration: Inspiration,
    group: Option<u32>,
    row: usize,
    /// Number of starts that lie before the row.
    started: usize,
}

impl<R> Phased<R> {
    pub(super) fn new(source: R, marks: Marks) -> Self {
        Self { source, marks, inspiration: Inspiration::default(), group: None, row: 0, started: 0 }
    }
}

impl<R: RowSource> RowSource for Phased<R> {
    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let Some(mut row) = self.source.next(groups)? else { return Ok(None) };
        match &self.marks {
            Marks::Own => {}
            Marks::Starts(starts) => {
                row.next_breath = starts.get(self.started) == Some(&self.row);
                self.started += usize::from(row.next_breath);
            }
            Marks::Phases(by) | Marks::Breaths(by) => {
                if self.group.replace(row.group) != Some(row.group) {
                    self.inspiration = Inspiration::default();
                }
                let starts = self.inspiration.starts(*by, row.flow(), row.get(Quantity::Pressure));
                if matches!(self.marks, Marks::Breaths(_)) {
                    row.next_breath = starts;
                }
                row.inspires = self.inspiration.inhales;
            }
        }
        self.row += 1;
        Ok(Some(row))
    }

    fn position(&self) -> u64 {
        self.source.position()
    }

    fn unused(&self) -> std::collections::BTreeMap<String, usize> {
        self.source.unused()
    }

    fn disorder(&self) -> Disorder {
        self.source.disorder()
    }
}
