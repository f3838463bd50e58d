//! The pressure-control rows of the test table (ISO 80601-2-12, table 201.105, as the open-ventilator community transcribed
//! it): plateau, overshoot, rise and tidal volume, PID and learned side by side.

use serde::{Deserialize, Serialize};
use shared::breath::{ISO_ROWS, IsoRow, Phase};
use shared::control::Controller;

use super::generalist;
use super::study::Study;
use crate::error::Result;
use judge::evaluate::{InspirationRecord, Score, plateau_tolerance};
use plant::bench::BenchConfig;
use progress::Stage;
use ventilator::{BenchSource, Source, SourceError};

/// Breaths before the measured one: low rates and long time constants need several.
const WARM_UP: usize = 5;

/// Result of one controller on a row.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct IsoOutcome {
    /// Scores of the inspiration.
    pub(super) score: Score,
    /// Volume that entered the lung, mL.
    pub(super) tidal_volume: f64,
    /// Whether the plateau is within the tolerance.
    pub(super) pass: bool,
}

/// Result of a row.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct IsoResult {
    /// Row number in the table.
    pub(super) number: u8,
    /// Resistance, cmH2O/(L/s), and compliance, mL/cmH2O.
    pub(super) lung: (f32, f32),
    /// PIP and PEEP, cmH2O.
    pub(super) pressures: (f32, f32),
    /// Tidal volume that the table expects, mL.
    pub(super) expected_volume: f64,
    /// The best single PID; `None` if the ventilator entered its safe state.
    pub(super) single_pid: Option<IsoOutcome>,
    /// The controller for all lungs; `None` if the ventilator entered its safe state.
    pub(super) generalist: Option<IsoOutcome>,
}

/// Runs all rows.
pub(super) fn iso(study: &Study<'_>) -> Result<Vec<IsoResult>> {
    study.keep("iso", || {
        let (learned, single) = generalist::with_rival(study)?;
        let benches = BenchConfig::iso_lungs();
        let task = study.progress.of("test table").task(Stage::Evaluate, ISO_ROWS.len());
        ISO_ROWS
            .iter()
            .zip(&benches)
            .map(|(row, bench)| {
                task.advance(1);
                Ok(IsoResult {
                    number: row.number,
                    lung: (row.resistance, row.compliance),
                    pressures: (row.pip, row.peep),
                    expected_volume: f64::from(row.tidal_volume),
                    single_pid: outcome(study, row, bench, &single)?,
                    generalist: outcome(study, row, bench, &learned)?,
                })
            })
            .collect()
    })
}

fn outcome(
    study: &Study<'_>,
    row: &IsoRow,
    bench: &BenchConfig,
    controller: &Controller,
) -> Result<Option<IsoOutcome>> {
    match run(study, row, bench, controller) {
        Ok(outcome) => Ok(Some(outcome)),
        Err(SourceError::Fault { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

fn run(
    study: &Study<'_>,
    row: &IsoRow,
    bench: &BenchConfig,
    controller: &Controller,
) -> Result<IsoOutcome, SourceError> {
    let (plan, settings) = (study.plan(), row.settings());
    let mut source = BenchSource::new(bench, controller.clone(), &settings, plan.period_us, plan.seeds[0])?;
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
    let score = record.score(&settings, plan.period_us);
    let pass = score.plateau_error <= plateau_tolerance(row.pip);
    Ok(IsoOutcome { score, tidal_volume: most - least, pass })
}
