//! Curves with known figures, and recordings with every flaw that a third party's can have.

mod advices;
mod asynchronies;
mod bench;
mod figures;
mod flaws;
mod measured;
mod patient;
mod targets;
mod verdicts;

use super::*;
use data::identity::TestRun;
use data::provenance::Provenance;
use data::recording::{EXPIRATION, Extra, INSPIRATION, Row};

/// PEEP and PIP of all breaths, cmH2O.
const PEEP: f64 = 5.0;
const PIP: f64 = 25.0;

/// A recording to build: every breath has an inspiration of 1 s, and 2 s later the next one starts.
struct Build<'a> {
    period_us: u32,
    breaths: u32,
    /// Target and pressure, cmH2O, `t` s after the start of a breath.
    target: &'a dyn Fn(f64) -> f64,
    pressure: &'a dyn Fn(f64) -> f64,
    /// Optional columns.
    extras: &'a [Extra],
    /// Last changes to a row, by its breath and time; `false` leaves it out.
    edit: &'a dyn Fn(f64, &mut Row) -> bool,
}

/// A square target.
fn square(t: f64) -> f64 {
    if t < 1.0 - 1e-9 { PIP } else { PEEP }
}

/// A pressure that follows the target within 0.1 s, up and down.
fn good(t: f64) -> f64 {
    if t < 1.0 { (PEEP + 200.0 * t).min(PIP) } else { (PIP - 200.0 * (t - 1.0)).max(PEEP) }
}

impl Default for Build<'_> {
    /// Four good breaths at 1 kHz.
    fn default() -> Self {
        Self {
            period_us: 1_000,
            breaths: 4,
            target: &square,
            pressure: &good,
            extras: &[],
            edit: &|_, _| true,
        }
    }
}

impl Build<'_> {
    fn recording(&self) -> Recording {
        let mut recording = Recording::with_extras(Provenance::new(self.period_us, "test"), self.extras);
        recording.provenance.groups = vec![TestRun::new("A", "1"), TestRun::new("A", "2")];
        let period_s = recording.provenance.period_s();
        let ticks = (3.0 / period_s).round() as u32;
        for (breath, tick) in (0..self.breaths).flat_map(|breath| (0..ticks).map(move |tick| (breath, tick)))
        {
            let t = f64::from(tick) * period_s;
            let mut row = Row {
                breath,
                tick,
                phase: if t < 1.0 - 1e-9 { INSPIRATION } else { EXPIRATION },
                target: (self.target)(t) as f32,
                pressure: (self.pressure)(t) as f32,
                pip: PIP as f32,
                peep: PEEP as f32,
                resistance: Some(20.0),
                compliance: Some(50.0),
                group: Some(0),
                ..Row::default()
            };
            if (self.edit)(t, &mut row) {
                recording.push(row);
            }
        }
        recording
    }

    fn verdict(&self) -> Verdict {
        judge(&self.recording(), Judged::True, &Limits::default()).unwrap()
    }

    /// The figures of the first breath.
    fn figures(&self) -> Figures {
        self.verdict().breaths.remove(0).figures
    }
}

/// The figures of the first breath with this pressure.
fn figures_of(pressure: impl Fn(f64) -> f64) -> Figures {
    Build { pressure: &pressure, ..Build::default() }.figures()
}

fn close(actual: Option<f64>, expected: f64, tolerance: f64) {
    let actual = actual.expect("the figure is known");
    assert!((actual - expected).abs() <= tolerance, "{actual}, not {expected}");
}

/// Whether a remark contains these words.
fn remarked(figures: &Figures, words: &str) -> bool {
    figures.remarks.iter().any(|remark| remark.contains(words))
}
