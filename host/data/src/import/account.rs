//! What an import found: counts, and the properties of the measurement that a model must respect.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::map::Quantity;
use super::reader::TableRow;
use super::saturation::Saturation;
use crate::recording::quality::{noise_of_second_differences, quantum};
use crate::recording::{INSPIRATION, Row};

/// Rows from which quantum and noise are estimated: the first of them, so that memory has a bound.
const JUDGED: usize = 500_000;
/// A command this near to 0 or 100 percent is at the end of the valve's range.
const AT_END: f64 = 1e-6;

/// Valves whose saturation is told.
const VALVES: [Quantity; 3] = [Quantity::UIn, Quantity::UOut, Quantity::UPsol];

/// Lowest and highest value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Extremes {
    /// Lowest.
    pub low: f64,
    /// Highest.
    pub high: f64,
}

impl Default for Extremes {
    /// Of no values.
    fn default() -> Self {
        Self { low: f64::INFINITY, high: f64::NEG_INFINITY }
    }
}

impl Extremes {
    fn add(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }
}

/// Gathers the account while samples stream by.
#[derive(Debug, Default)]
pub(super) struct Account {
    /// What is counted; the rest of it follows with [`Self::finish`].
    pub(super) counts: ImportSummary,
    /// Rows at an end of the inspiratory valve's range while the expiratory valve is not open, and all such rows.
    saturated: (usize, usize),
    valves: [Saturation; 3],
    pressures: Vec<f32>,
    second_differences: Vec<f32>,
    /// Pressures of the two rows before that follow on.
    before: [Option<f32>; 2],
}

impl Account {
    /// Notes a row, and the one before if it follows on.
    pub(super) fn sample(&mut self, sample: &TableRow, last: Option<&TableRow>) {
        self.counts.rows += 1;
        let pressure = sample.get(Quantity::Pressure);
        self.counts.pressure.add(pressure);
        self.counts.u_in.add(sample.get(Quantity::UIn));
        for (valve, quantity) in self.valves.iter_mut().zip(VALVES) {
            valve.add(sample.get(quantity));
        }
        let pressure = pressure as f32;
        if let Some(last) = last {
            self.counts.step_ms.add(1e3 * (sample.get(Quantity::Time) - last.get(Quantity::Time)));
        } else {
            self.before = [None; 2];
        }
        if self.pressures.len() < JUDGED {
            self.pressures.push(pressure);
            if let [Some(a), Some(b)] = self.before {
                self.second_differences.push((a - 2.0 * b + pressure).abs());
            }
            self.before = [self.before[1], Some(pressure)];
        }
    }

    /// Notes a breath: its samples, and the rows that it became.
    pub(super) fn breath(&mut self, samples: &[TableRow], rows: &[Row]) {
        let inspires = |row: &Row| row.phase == INSPIRATION;
        self.counts.breaths += 1;
        self.counts.complete_breaths += usize::from(inspires(&rows[0]) && !rows.iter().all(inspires));
        self.counts.kept += rows.len();
        if let Some(lung) = rows[0].lung() {
            *self.counts.lungs.entry(lung.to_string()).or_default() += 1;
        }
        for command in
            samples.iter().take_while(|s| s.get(Quantity::UOut) < 50.0).map(|s| s.get(Quantity::UIn))
        {
            self.saturated.0 += usize::from(command <= AT_END || command >= 100.0 - AT_END);
            self.saturated.1 += 1;
        }
    }

    pub(super) fn end_of_table(&mut self) {
        self.valves.iter_mut().for_each(Saturation::end_of_table);
    }

    /// The account of so many test runs.
    pub(super) fn finish(mut self, period_us: u32, tests: usize) -> ImportSummary {
        let [saturated_inhale, saturated_exhale, saturated_psol] =
            self.valves.each_ref().map(Saturation::share);
        ImportSummary {
            tests,
            period_us,
            quantum: quantum(&self.pressures),
            noise: noise_of_second_differences(&mut self.second_differences),
            saturated: self.saturated.0 as f64 / self.saturated.1.max(1) as f64,
            saturated_inhale,
            saturated_exhale,
            saturated_psol,
            ..self.counts
        }
    }
}

/// Account of an import.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ImportSummary {
    /// Rows read.
    pub rows: usize,
    /// Rows written; a breath that was put on an even grid may have a few more or less than were read.
    pub kept: usize,
    /// Rows before the first breath of a table or group.
    pub dropped_before_first_breath: usize,
    /// Rows between a gap in time and the next breath.
    pub dropped_after_gap: usize,
    /// Test runs; a table without groups is one.
    pub tests: usize,
    /// Breaths, complete or not.
    pub breaths: usize,
    /// Breaths with a complete inspiration.
    pub complete_breaths: usize,
    /// Breaths whose time steps were uneven and that were put on an even grid.
    pub resampled_breaths: usize,
    /// Furthest that a row was from the grid, ms.
    pub furthest_from_grid_ms: f64,
    /// Gaps in time within breaths or between them.
    pub gaps: usize,
    /// Sample period of the recording, microseconds.
    pub period_us: u32,
    /// Shortest and longest time step between rows that follow on, ms.
    pub step_ms: Extremes,
    /// Pressures, cmH2O.
    pub pressure: Extremes,
    /// Commands of the inspiratory valve, percent.
    pub u_in: Extremes,
    /// Smallest step of the pressure column, cmH2O; 0 if there is none.
    pub quantum: f64,
    /// Standard deviation of the pressure noise, cmH2O.
    pub noise: f64,
    /// Share of rows before the expiratory valve opens with the inspiratory valve shut or fully open, 0..1.
    pub saturated: f64,
    /// Share of all rows with the inspiratory valve at an end of the range that it uses, 0..1.
    pub saturated_inhale: f64,
    /// The same of the expiratory valve.
    pub saturated_exhale: f64,
    /// The same of the second inspiratory valve (oxygen).
    pub saturated_psol: f64,
    /// Breaths by nominal `R:C`, if the table has them.
    pub lungs: BTreeMap<String, usize>,
}

impl ImportSummary {
    /// The whole in a line, for the recording.
    pub(super) fn note(&self) -> String {
        format!(
            "{} rows read, {} dropped, {} gaps, {} breaths put on an even grid, {:.1} % of inspiratory rows with the \
             valve at an end",
            self.rows,
            self.dropped_before_first_breath + self.dropped_after_gap,
            self.gaps,
            self.resampled_breaths,
            100.0 * self.saturated
        )
    }
}

impl fmt::Display for ImportSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let range =
            |range: &Extremes, digits: usize| format!("{:.digits$} to {:.digits$}", range.low, range.high);
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let mut lines = vec![
            ("rows read", self.rows.to_string()),
            ("rows written", self.kept.to_string()),
            ("rows dropped", (self.dropped_before_first_breath + self.dropped_after_gap).to_string()),
            ("  before the first breath", self.dropped_before_first_breath.to_string()),
            ("  after a gap", self.dropped_after_gap.to_string()),
            ("test runs", self.tests.to_string()),
            ("breaths", format!("{} ({} complete)", self.breaths, self.complete_breaths)),
            ("gaps in time", self.gaps.to_string()),
            ("sample period", format!("{} ms", f64::from(self.period_us) * 1e-3)),
            ("time steps", format!("{} ms", range(&self.step_ms, 2))),
            (
                "put on an even grid",
                format!(
                    "{} breaths, rows up to {:.2} ms off it",
                    self.resampled_breaths, self.furthest_from_grid_ms
                ),
            ),
            ("pressure", format!("{} cmH2O", range(&self.pressure, 2))),
            ("pressure quantum", format!("{:.4} cmH2O", self.quantum)),
            ("pressure noise (sd)", format!("{:.3} cmH2O", self.noise)),
            ("inspiratory valve", format!("{} %", range(&self.u_in, 1))),
            ("  shut or fully open", format!("{:.1} % of inspiratory rows", 100.0 * self.saturated)),
            ("  at an end of its use", percent(self.saturated_inhale)),
            ("expiratory valve at an end", percent(self.saturated_exhale)),
            ("oxygen valve at an end", percent(self.saturated_psol)),
        ];
        let lungs: Vec<_> = self.lungs.iter().map(|(lung, breaths)| format!("{lung} ({breaths})")).collect();
        lines.extend((!lungs.is_empty()).then(|| ("lungs R:C (breaths)", lungs.join(", "))));
        let lines: Vec<_> = lines.iter().map(|(name, value)| format!("{name:<27} {value}")).collect();
        write!(f, "{}", lines.join("\n"))
    }
}
