//! The pressure-control rows of the test table on the nominal machine, PID and learned side by side.

use serde::{Deserialize, Serialize};
use shared::breath::ISO_ROWS;

use super::generalist;
use super::study::Study;
use plant::bench::BenchConfig;
use score::evaluate::EVALUATE;
use study::Result;
use trials::test_table::{Outcome, outcome};

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
    pub(super) single_pid: Option<Outcome>,
    /// The controller for all lungs; `None` if the ventilator entered its safe state.
    pub(super) generalist: Option<Outcome>,
}

/// Runs all rows.
pub(super) fn iso(study: &Study<'_>) -> Result<Vec<IsoResult>> {
    study.keep("iso", || {
        let (learned, single) = generalist::with_rival(study)?;
        let benches = BenchConfig::iso_lungs();
        let seed = study.plan().seeds[0];
        let task = study.progress.of("test table").task(EVALUATE, ISO_ROWS.len());
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
                    single_pid: outcome(row, bench, &single, seed)?,
                    generalist: outcome(row, bench, &learned, seed)?,
                })
            })
            .collect()
    })
}
