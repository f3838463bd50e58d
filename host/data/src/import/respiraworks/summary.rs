//! What an import found: counts, and the properties of the measurement that a model must respect.

use std::fmt;

use super::table::Sample;
use crate::recording::Recording;
use crate::recording::quality::{noise_of_second_differences, quantum_of_sorted, second_differences};

/// Rows that belong to no breath, by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Dropped {
    /// Before the set-point of a test rises for the first time.
    pub before_first_rise: usize,
    /// Between a gap in time and the next rise.
    pub after_gap: usize,
}

/// Account of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportSummary {
    /// Rows read.
    pub rows: usize,
    /// Rows kept.
    pub kept: usize,
    /// Rows left out.
    pub dropped: Dropped,
    /// Tests, that is runs of one lung setting.
    pub tests: usize,
    /// Breaths, complete or not.
    pub breaths: usize,
    /// Breaths with a complete inspiration.
    pub complete_breaths: usize,
    /// Gaps in time within a test.
    pub gaps: usize,
    /// Sample period, microseconds.
    pub period_us: u32,
    /// Lowest and highest pressure, cmH2O.
    pub pressure_range: (f32, f32),
    /// Smallest step of the pressure column, cmH2O; 0 if there is none.
    pub quantum: f64,
    /// Standard deviation of the pressure noise, cmH2O, from the median second difference.
    pub noise: f64,
    /// Share of rows with the inhale valve at either end of its range, over runs that use it, 0..1.
    pub saturated_inhale: f64,
    /// The same of the exhale valve.
    pub saturated_exhale: f64,
    /// The same of the oxygen valve.
    pub saturated_psol: f64,
}

impl fmt::Display for ImportSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let dropped = self.dropped.before_first_rise + self.dropped.after_gap;
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let lines = [
            ("rows read", self.rows.to_string()),
            ("rows kept", self.kept.to_string()),
            ("rows dropped", dropped.to_string()),
            ("  before the first rise", self.dropped.before_first_rise.to_string()),
            ("  after a gap", self.dropped.after_gap.to_string()),
            ("tests", self.tests.to_string()),
            ("breaths", format!("{} ({} complete)", self.breaths, self.complete_breaths)),
            ("gaps in time", self.gaps.to_string()),
            ("sample period", format!("{} ms", f64::from(self.period_us) * 1e-3)),
            ("pressure", format!("{:.2} to {:.2} cmH2O", self.pressure_range.0, self.pressure_range.1)),
            ("pressure quantum", format!("{:.4} cmH2O", self.quantum)),
            ("pressure noise (sd)", format!("{:.3} cmH2O", self.noise)),
            ("inhale valve saturated", percent(self.saturated_inhale)),
            ("exhale valve saturated", percent(self.saturated_exhale)),
            ("oxygen valve saturated", percent(self.saturated_psol)),
        ];
        for (index, (name, value)) in lines.iter().enumerate() {
            let end = if index + 1 < lines.len() { "\n" } else { "" };
            write!(f, "{name:<25} {value}{end}")?;
        }
        Ok(())
    }
}

/// Gathers the summary while tests stream by.
#[derive(Default)]
pub(super) struct Observer {
    rows: usize,
    tests: usize,
    gaps: usize,
    dropped: Dropped,
    pressures: Vec<f32>,
    second_differences: Vec<f32>,
    valves: [Valve; 3],
}

impl Observer {
    /// Notes a whole test, named run and number.
    pub(super) fn test(&mut self, name: &str, samples: &[Sample]) {
        self.tests += 1;
        self.rows += samples.len();
        self.pressures.extend(samples.iter().map(|sample| sample.pressure));
        let run = name.rsplit_once(':').map_or(name, |(run, _)| run);
        for sample in samples {
            for (valve, command) in self.valves.iter_mut().zip([sample.inhale, sample.exhale, sample.psol]) {
                valve.add(run, command);
            }
        }
    }

    /// Notes rows without a gap, the first `dropped` of which belong to no breath.
    pub(super) fn segment(&mut self, samples: &[Sample], dropped: usize, after_gap: bool) {
        if after_gap {
            self.gaps += 1;
            self.dropped.after_gap += dropped;
        } else {
            self.dropped.before_first_rise += dropped;
        }
        let pressures: Vec<f32> = samples.iter().map(|sample| sample.pressure).collect();
        self.second_differences.extend(second_differences(&pressures));
    }

    pub(super) fn finish(mut self, recording: &Recording, breaths: u32) -> ImportSummary {
        self.pressures.sort_by(f32::total_cmp);
        let ends = (self.pressures.first(), self.pressures.last());
        let [saturated_inhale, saturated_exhale, saturated_psol] = self.valves.map(Valve::saturated);
        ImportSummary {
            rows: self.rows,
            kept: recording.len(),
            dropped: self.dropped,
            tests: self.tests,
            breaths: breaths as usize,
            complete_breaths: recording.inspirations().len(),
            gaps: self.gaps,
            period_us: recording.provenance.period_us,
            pressure_range: (ends.0.copied().unwrap_or(0.0), ends.1.copied().unwrap_or(0.0)),
            quantum: quantum_of_sorted(&self.pressures),
            noise: noise_of_second_differences(&mut self.second_differences),
            saturated_inhale,
            saturated_exhale,
            saturated_psol,
        }
    }
}

/// Counts how often one valve is at an end of the range that it uses in a run.
#[derive(Default)]
struct Valve {
    run: String,
    low: End,
    high: End,
    rows: usize,
    /// Over the runs before this one.
    past_saturated: usize,
    past_rows: usize,
}

#[derive(Clone, Copy, Default)]
struct End {
    command: f32,
    rows: usize,
}

impl Valve {
    fn add(&mut self, run: &str, command: f32) {
        if self.run != run {
            self.close_run();
            run.clone_into(&mut self.run);
        }
        if self.rows == 0 || command < self.low.command {
            self.low = End { command, rows: 0 };
        }
        if self.rows == 0 || command > self.high.command {
            self.high = End { command, rows: 0 };
        }
        self.rows += 1;
        self.low.rows += usize::from(command <= self.low.command);
        self.high.rows += usize::from(command >= self.high.command);
    }

    /// A valve that never moved in a run was not in use.
    fn close_run(&mut self) {
        if self.low.command < self.high.command {
            self.past_saturated += self.low.rows + self.high.rows;
            self.past_rows += self.rows;
        }
        self.rows = 0;
    }

    fn saturated(mut self) -> f64 {
        self.close_run();
        if self.past_rows == 0 { 0.0 } else { self.past_saturated as f64 / self.past_rows as f64 }
    }
}
