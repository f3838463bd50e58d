//! The pressure-control rows of the test table (ISO 80601-2-12, table 201.105, as the open-ventilator community transcribed it): plateau,
//! overshoot, rise and tidal volume of a controller.

use serde::{Deserialize, Serialize};
use shared::breath::{DEFAULT_PERIOD_US, IsoRow, Phase};
use shared::control::Controller;

use plant::bench::BenchConfig;
use score::evaluate::{InspirationRecord, Score, plateau_tolerance};
use ventilator::{BenchSource, Source, SourceError};

/// Breaths before the measured one: low rates and long time constants need several.
const WARM_UP: usize = 5;
/// Largest overshoot of a steady row, cmH2O.
pub const MOST_OVERSHOOT: f64 = 2.0;

/// Result of a controller on a row.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Scores of the inspiration.
    pub score: Score,
    /// Volume that entered the lung, mL.
    pub tidal_volume: f64,
    /// Whether the plateau is within the tolerance.
    #[serde(alias = "pass")]
    pub plateau_within: bool,
}

impl Outcome {
    /// Whether the overshoot is small as well.
    pub fn steady(&self) -> bool {
        self.plateau_within && self.score.overshoot <= MOST_OVERSHOOT
    }
}

/// Runs a controller on a row's breaths with this bench; none if the ventilator entered its safe state.
///
/// # Errors
/// A bench or settings that cannot be run.
pub fn outcome(
    row: &IsoRow,
    bench: &BenchConfig,
    controller: &Controller,
    seed: u64,
) -> Result<Option<Outcome>, SourceError> {
    match run(row, bench, controller, seed) {
        Err(SourceError::Fault { .. }) => Ok(None),
        outcome => outcome.map(Some),
    }
}

fn run(
    row: &IsoRow,
    bench: &BenchConfig,
    controller: &Controller,
    seed: u64,
) -> Result<Outcome, SourceError> {
    let settings = row.settings();
    let mut source = BenchSource::new(bench, controller.clone(), &settings, DEFAULT_PERIOD_US, seed)?;
    for _ in 0..WARM_UP {
        source.breath(&settings, &mut |_| ())?;
    }
    let mut record = InspirationRecord::default();
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    source.breath(&settings, &mut |tick| {
        record.add(tick);
        if let (Phase::Inspiration, Some(truth)) = (tick.sample.phase, tick.truth) {
            least = least.min(f64::from(truth.lung_volume));
            most = most.max(f64::from(truth.lung_volume));
        }
    })?;
    let score = record.score(&settings, DEFAULT_PERIOD_US);
    let plateau_within = score.plateau_error <= plateau_tolerance(row.pip);
    Ok(Outcome { score, tidal_volume: most - least, plateau_within })
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::breath::ISO_ROWS;
    use shared::control::pid::{Pid, PidGains};

    fn row_5(gains: PidGains) -> Option<Outcome> {
        let controller = Controller::Pid(Pid::new(gains, DEFAULT_PERIOD_US).unwrap());
        outcome(&ISO_ROWS[4], &BenchConfig::iso_matched()[4], &controller, 3).unwrap()
    }

    #[test]
    fn a_row_passes_with_a_plateau_within_the_tolerance_and_its_volume() {
        let tuned = row_5(PidGains { p: 3.0, i: 30.0, d: 0.0 }).unwrap();
        assert!(tuned.plateau_within && (tuned.tidal_volume - 300.0).abs() < 30.0, "{tuned:?}");
        let weak = row_5(PidGains { p: 0.5, i: 0.0, d: 0.0 }).unwrap();
        assert!(!weak.plateau_within && !weak.steady(), "{weak:?}");
    }

    #[test]
    fn a_row_with_a_good_plateau_is_steady_only_without_a_large_overshoot() {
        let tuned = row_5(PidGains { p: 3.0, i: 30.0, d: 0.0 }).unwrap();
        let with = |overshoot| Outcome { score: Score { overshoot, ..tuned.score }, ..tuned };
        assert!(with(MOST_OVERSHOOT).steady() && !with(MOST_OVERSHOOT + 0.1).steady());
    }
}
