//! The pressure-control rows of the test table (ISO 80601-2-12, table 201.105, as the open-ventilator community transcribed
//! it): plateau, overshoot, rise and tidal volume, PID and learned side by side.

use serde::{Deserialize, Serialize};
use shared::breath::{ISO_ROWS, IsoRow, Phase, period_s};
use shared::control::Controller;

use super::study::Study;
use super::{generalist, lungs};
use crate::StudyError;
use judge::evaluate::{Inspiration, Score, score_breath};
use plant::bench::BenchConfig;
use progress::Stage;
use ventilator::{BenchSource, Source, SourceError};

/// Breaths before the measured one: low rates and long time constants need some.
const WARM_UP: usize = 5;
/// Allowed distance of the plateau from PIP: so much, and so much of PIP.
const PLATEAU_TOLERANCE: (f64, f64) = (2.0, 0.04);

/// What one controller does on a row.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct IsoOutcome {
    /// Scores of the inspiration.
    pub(super) score: Score,
    /// Volume that entered the lung, mL.
    pub(super) tidal_volume: f64,
    /// Whether the plateau keeps the tolerance.
    pub(super) pass: bool,
}

/// A row.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct IsoResult {
    /// Its number in the table.
    pub(super) number: u8,
    /// Resistance, cmH2O/(L/s), and compliance, mL/cmH2O.
    pub(super) lung: (f32, f32),
    /// PIP and PEEP, cmH2O.
    pub(super) pressures: (f32, f32),
    /// Tidal volume that the table expects, mL.
    pub(super) expected_volume: f64,
    /// The best single PID; none where the ventilator went to its safe state.
    pub(super) single_pid: Option<IsoOutcome>,
    /// The controller for all lungs; none where the ventilator went to its safe state.
    pub(super) generalist: Option<IsoOutcome>,
}

/// Runs all rows.
pub(super) fn iso(study: &Study<'_>) -> Result<Vec<IsoResult>, StudyError> {
    study.keep("iso", || {
        let learned = generalist::controller(study)?;
        let single = study.pid(lungs::tuned(study)?.over_all.pid.gains)?;
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

/// What the folder holds.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Vec<IsoResult>>, StudyError> {
    study.kept("iso")
}

fn outcome(
    study: &Study<'_>,
    row: &IsoRow,
    bench: &BenchConfig,
    controller: &Controller,
) -> Result<Option<IsoOutcome>, StudyError> {
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
    let (mut pressure, mut target, mut volume) = (Vec::new(), Vec::new(), Vec::new());
    source.breath(&settings, &mut |tick| {
        if let (Phase::Inspiration, Some(truth)) = (tick.sample.phase, tick.truth) {
            pressure.push(f64::from(truth.airway_pressure));
            target.push(f64::from(tick.sample.target));
            volume.push(f64::from(truth.lung_volume));
        }
    })?;
    let (peep, pip) = (f64::from(row.peep), f64::from(row.pip));
    let period_s = f64::from(period_s(plan.period_us));
    let score = score_breath(&Inspiration { period_s, peep, pip, pressure: &pressure, target: &target });
    let allowed = PLATEAU_TOLERANCE.0 + PLATEAU_TOLERANCE.1 * pip;
    let least = volume.iter().copied().fold(f64::INFINITY, f64::min);
    let most = volume.iter().copied().fold(0.0, f64::max);
    Ok(IsoOutcome { score, tidal_volume: most - least, pass: score.plateau_error <= allowed })
}
