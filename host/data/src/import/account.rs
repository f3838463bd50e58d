//! Summary of an import: counts, and the properties of the measurement that a model must respect.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::map::Quantity;
use super::rows::{Disorder, TableRow};
use super::saturation::Saturation;
use crate::recording::quality::{noise_of_second_differences, quantum};
use crate::recording::{INSPIRATION, Row};

/// Number of rows from which quantum and noise are estimated: the first ones, so that memory is bounded.
const JUDGED: usize = 500_000;
/// Distance from 0 or 100 percent below which a command counts as at the end of the valve's range.
const AT_END: f64 = 1e-6;

/// Pressures that a ventilator's record usually stays within, cmH2O.
const PRESSURE_USUAL: (f64, f64) = (-60.0, 120.0);
/// Least change of the pressure in breaths, cmH2O.
const PRESSURE_LEAST: f64 = 2.0;
/// Pressure that breaths in kPa stay below.
const KILOPASCALS: f64 = 6.0;
/// Flow that patients hardly reach, L/s.
const FLOW_USUAL: f64 = 6.0;

/// Correlation of flow and pressure below which the flow seems turned round, and the spread of the pressure from which this is judged,
/// cmH2O: at a constant pressure, patients lower it as they inhale.
const TURNED_ROUND: f64 = -0.3;
const SPREAD: f64 = 2.0;

/// Valves whose saturation is reported.
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
    /// The extremes of an empty set.
    fn default() -> Self {
        Self { low: f64::INFINITY, high: f64::NEG_INFINITY }
    }
}

impl Extremes {
    fn add(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    fn text(&self, digits: usize) -> String {
        format!("{:.digits$} to {:.digits$}", self.low, self.high)
    }
}

/// Sums over pressures and flows.
#[derive(Debug, Default)]
struct Sums {
    rows: f64,
    pressure: f64,
    flow: f64,
    pressure_squared: f64,
    flow_squared: f64,
    both: f64,
}

impl Sums {
    fn add(&mut self, pressure: f64, flow: f64) {
        self.rows += 1.0;
        self.pressure += pressure;
        self.flow += flow;
        self.pressure_squared += pressure * pressure;
        self.flow_squared += flow * flow;
        self.both += pressure * flow;
    }

    /// Correlation of flow and pressure, where the pressure changes; otherwise 0.
    fn correlation(&self) -> f64 {
        let covariance =
            |product: f64, a: f64, b: f64| (product - a * b / self.rows.max(1.0)) / self.rows.max(1.0);
        let pressure = covariance(self.pressure_squared, self.pressure, self.pressure);
        let flow = covariance(self.flow_squared, self.flow, self.flow);
        let correlation = covariance(self.both, self.pressure, self.flow) / (pressure * flow).sqrt();
        if pressure > SPREAD * SPREAD && correlation.is_finite() { correlation } else { 0.0 }
    }
}

/// Collects the summary while samples stream by.
#[derive(Debug, Default)]
pub(super) struct Account {
    /// The counts; [`Self::finish`] adds the rest.
    pub(super) counts: ImportSummary,
    /// Rows at an end of the inspiratory valve's range while the expiratory valve is not open, and all such rows.
    saturated: (usize, usize),
    valves: [Saturation; 3],
    sums: Sums,
    pressures: Vec<f32>,
    second_differences: Vec<f32>,
    /// Pressures of the two preceding rows without a gap.
    before: [Option<f32>; 2],
}

impl Account {
    /// Counts a row; `last` is the row before it, if there is no gap between them.
    pub(super) fn sample(&mut self, sample: &TableRow, last: Option<&TableRow>) {
        self.counts.rows += 1;
        let pressure = sample.get(Quantity::Pressure);
        self.counts.pressure.add(pressure);
        self.counts.flow.add(sample.flow());
        self.sums.add(pressure, sample.flow());
        let known = sample.get(Quantity::UIn).is_finite();
        if known {
            self.counts.u_in.add(sample.get(Quantity::UIn));
        }
        for (valve, quantity) in self.valves.iter_mut().zip(VALVES).filter(|_| known) {
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

    /// Counts a breath: its samples, and the rows written for it.
    pub(super) fn breath(&mut self, samples: &[TableRow], rows: &[Row]) {
        let inspires = |row: &Row| row.phase == INSPIRATION;
        self.counts.breaths += 1;
        self.counts.complete_breaths += usize::from(inspires(&rows[0]) && !rows.iter().all(inspires));
        self.counts.kept += rows.len();
        if let Some(lung) = rows[0].lung() {
            *self.counts.lungs.entry(lung.to_string()).or_default() += 1;
        }
        let inspiration = samples.iter().take_while(|sample| !sample.opens_out());
        for command in inspiration.map(|s| s.get(Quantity::UIn)).filter(|command| command.is_finite()) {
            self.saturated.0 += usize::from(command <= AT_END || command >= 100.0 - AT_END);
            self.saturated.1 += 1;
        }
    }

    /// Ends a table of which so many events, by name, are in no row.
    pub(super) fn end_of_table(&mut self, unused: BTreeMap<String, usize>, disorder: Disorder) {
        self.counts.disorder.add(disorder);
        self.counts.rows += disorder.dropped();
        for (name, events) in unused {
            *self.counts.unused.entry(name).or_default() += events;
        }
        self.valves.iter_mut().for_each(Saturation::end_of_table);
    }

    /// The summary of an import of this number of test runs.
    pub(super) fn finish(
        mut self,
        period_us: u32,
        tests: usize,
        breaths_from: &'static str,
    ) -> ImportSummary {
        let [saturated_inhale, saturated_exhale, saturated_psol] =
            self.valves.each_ref().map(Saturation::share);
        ImportSummary {
            tests,
            period_us,
            breaths_from,
            correlation: self.sums.correlation(),
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

/// Summary of an import.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ImportSummary {
    /// Number of rows read.
    pub rows: usize,
    /// Number of rows written; resampling a breath can change its number of rows slightly.
    pub kept: usize,
    /// Number of rows before the first breath of a table or group.
    pub dropped_before_first_breath: usize,
    /// Number of rows between a gap in time and the next breath.
    pub dropped_after_gap: usize,
    /// Rows that were there twice or out of order.
    pub disorder: Disorder,
    /// What shows the breaths.
    pub breaths_from: &'static str,
    /// Test runs; a table without groups is one.
    pub tests: usize,
    /// Number of breaths, complete or not.
    pub breaths: usize,
    /// Number of breaths with a complete inspiration.
    pub complete_breaths: usize,
    /// Number of breaths with uneven time steps that were resampled to an even grid.
    pub resampled_breaths: usize,
    /// Largest distance of a row from the grid, ms.
    pub furthest_from_grid_ms: f64,
    /// Number of gaps in time within or between breaths.
    pub gaps: usize,
    /// Number of places within breaths at which a few missing rows were filled.
    pub filled: usize,
    /// Sample period of the recording, microseconds.
    pub period_us: u32,
    /// Shortest and longest time step between consecutive rows without a gap, ms.
    pub step_ms: Extremes,
    /// Pressures, cmH2O.
    pub pressure: Extremes,
    /// Net flows into the lung, L/s.
    pub flow: Extremes,
    /// Correlation of flow and pressure, -1..1; 0 if the pressure hardly changes.
    pub correlation: f64,
    /// Commands of the inspiratory valve, percent.
    pub u_in: Extremes,
    /// Smallest step of the pressure column, cmH2O; 0 if all pressures are equal.
    pub quantum: f64,
    /// Standard deviation of the pressure noise, cmH2O.
    pub noise: f64,
    /// Share of rows before the expiratory valve opens in which the inspiratory valve is closed or fully open, 0..1.
    pub saturated: f64,
    /// Share of all rows with the inspiratory valve at an end of the range in use, 0..1.
    pub saturated_inhale: f64,
    /// The same for the expiratory valve.
    pub saturated_exhale: f64,
    /// The same for the second inspiratory valve (oxygen).
    pub saturated_psol: f64,
    /// Number of breaths by nominal `R:C`, if the table has them.
    pub lungs: BTreeMap<String, usize>,
    /// Number of events that no row uses, by name; only of a format that consists of events.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub unused: BTreeMap<String, usize>,
}

impl ImportSummary {
    /// The summary in one line, stored in the recording.
    pub(super) fn note(&self) -> String {
        let rows = format!(
            "{} rows read, {} dropped, {} gaps, {} breaths put on an even grid",
            self.rows,
            self.dropped(),
            self.gaps,
            self.resampled_breaths,
        );
        if self.has_commands() {
            let saturated = 100.0 * self.saturated;
            return format!("{rows}, {saturated:.1} % of inspiratory rows with the valve at an end");
        }
        rows
    }

    /// Number of rows read that are not in the recording.
    fn dropped(&self) -> usize {
        self.dropped_before_first_breath + self.dropped_after_gap + self.disorder.dropped()
    }

    /// The lines about rows that were there twice or out of order.
    fn order(&self) -> Vec<(&'static str, String)> {
        let Disorder { repeated, same_time, reordered, late, heads } = self.disorder;
        let lines = [
            ("  equal to the one before", repeated),
            ("  at the time of another", same_time),
            ("  far too late", late),
            ("rows put in order of time", reordered),
            ("lines of units skipped", heads),
        ];
        let some = lines.into_iter().filter(|(_, count)| *count > 0);
        some.map(|(name, count)| (name, count.to_string())).collect()
    }

    /// What seems wrong with units or columns, as questions.
    pub fn questions(&self) -> Vec<String> {
        let mut questions = Vec::new();
        let Extremes { low, high } = self.pressure;
        if high > PRESSURE_USUAL.1 {
            questions.push(format!("pressure reaches {high:.0} cmH2O: are its unit and column right?"));
        }
        if low < PRESSURE_USUAL.0 {
            questions.push(format!("pressure falls to {low:.0} cmH2O: are its unit and column right?"));
        }
        if high - low < PRESSURE_LEAST && high < KILOPASCALS {
            questions.push(format!("pressure changes by {:.2} cmH2O only: is it in kPa?", high - low));
        }
        let flow = self.flow.high.max(-self.flow.low);
        if flow > FLOW_USUAL {
            questions.push(format!("flow reaches {flow:.0} L/s: is it in L/min?"));
        }
        if self.correlation < TURNED_ROUND {
            questions.push(
                "flow is out of the lung while the pressure is high: turn its sign (scale = -1)?".to_owned(),
            );
        }
        if self.complete_breaths * 2 < self.breaths {
            questions.push(format!(
                "only {} of {} breaths are complete: is the right column what starts and ends them?",
                self.complete_breaths, self.breaths
            ));
        }
        questions
    }

    /// Whether the tables give the commands of the inspiratory valve.
    fn has_commands(&self) -> bool {
        self.u_in.low <= self.u_in.high
    }

    /// The lines about the valves.
    fn valves(&self) -> Vec<(&'static str, String)> {
        if !self.has_commands() {
            return vec![("valves", "no commands".to_owned())];
        }
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        vec![
            ("inspiratory valve", format!("{} %", self.u_in.text(1))),
            ("  closed or fully open", format!("{:.1} % of inspiratory rows", 100.0 * self.saturated)),
            ("  at an end of its range", percent(self.saturated_inhale)),
            ("expiratory valve at an end", percent(self.saturated_exhale)),
            ("oxygen valve at an end", percent(self.saturated_psol)),
        ]
    }
}

impl fmt::Display for ImportSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut lines = vec![
            ("rows read", self.rows.to_string()),
            ("rows written", self.kept.to_string()),
            ("rows dropped", self.dropped().to_string()),
            ("  before the first breath", self.dropped_before_first_breath.to_string()),
            ("  after a gap", self.dropped_after_gap.to_string()),
        ];
        lines.extend(self.order());
        lines.extend([
            ("test runs", self.tests.to_string()),
            ("breaths", format!("{} ({} complete)", self.breaths, self.complete_breaths)),
            ("  shown by", self.breaths_from.to_owned()),
            ("gaps in time", self.gaps.to_string()),
            ("short gaps filled", self.filled.to_string()),
            ("sample period", format!("{} ms", f64::from(self.period_us) * 1e-3)),
            ("time steps", format!("{} ms", self.step_ms.text(2))),
            (
                "resampled to even grid",
                format!(
                    "{} breaths, rows up to {:.2} ms off the grid",
                    self.resampled_breaths, self.furthest_from_grid_ms
                ),
            ),
            ("pressure", format!("{} cmH2O", self.pressure.text(2))),
            ("pressure quantum", format!("{:.4} cmH2O", self.quantum)),
            ("pressure noise (sd)", format!("{:.3} cmH2O", self.noise)),
        ]);
        lines.extend(self.valves());
        let lungs: Vec<_> = self.lungs.iter().map(|(lung, breaths)| format!("{lung} ({breaths})")).collect();
        lines.extend((!lungs.is_empty()).then(|| ("lungs R:C (breaths)", lungs.join(", "))));
        let unused: Vec<_> = self.unused.iter().map(|(name, events)| format!("{name} ({events})")).collect();
        lines.extend((!unused.is_empty()).then(|| ("events not used", unused.join(", "))));
        lines.extend(self.questions().into_iter().map(|question| ("check", question)));
        let lines: Vec<_> = lines.iter().map(|(name, value)| format!("{name:<27} {value}")).collect();
        write!(f, "{}", lines.join("\n"))
    }
}
