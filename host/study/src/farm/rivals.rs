//! Baselines of a virtual farm, whose benches are known: the best single PID for all units, and the reference bound of each.

use serde::{Deserialize, Serialize};
use shared::control::pid::PidGains;

use super::{FarmRun, Worker};
use crate::error::{Result, StudyError};
use data::workspace::Workspace;
use plant::bench::{BenchConfig, UnitConfig};
use progress::Progress;
use score::baselines::Grid;
use score::baselines::{Search, tune_single_pid};
use score::bound::{BoundConfig, bounds};
use score::evaluate::{Plan, at_pips};

/// The best single PID of a virtual farm, and the bounds of its units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rivals {
    /// Gains of the best single PID: mean over all units and waveforms.
    pub pid: PidGains,
    /// Reference bound of each unit, in the order of the farm, cmH2O.
    pub bounds: Vec<f64>,
}

impl FarmRun<'_> {
    /// The rivals, searched once; none unless all units are virtual.
    pub(super) fn rivals(
        &self,
        folder: &Workspace,
        workers: &[Worker<'_>],
        progress: &Progress<'_>,
    ) -> Result<Option<Rivals>> {
        let benches: Option<Vec<BenchConfig>> =
            workers.iter().map(|worker| worker.unit.bench().map(calibrated)).collect();
        let Some(benches) = benches else { return Ok(None) };
        let run = &self.config.run;
        let waveforms =
            Plan { waveforms: at_pips(&run.collect.pips, &run.collect.settings), ..Plan::tuning(run.seed) };
        let search = Search { grid: Grid::coarse(), refinements: 4, exhaustive: false };
        let rivals = folder.keep("rivals.json", || {
            let pid = tune_single_pid(&benches, &search, &waveforms, &progress.of("best single PID"))?;
            let bounds = bounds(&benches, &waveforms, &BoundConfig::default(), &progress.of("bounds"))?;
            if progress.stopped() {
                return Err(StudyError::Stopped);
            }
            let bounds = bounds.iter().map(|bound| bound.mean.score).collect();
            Ok(Rivals { pid: pid.pid.gains, bounds })
        });
        rivals.map(Some)
    }
}

/// The bench with the zero of its sensor corrected, as the device corrects it.
fn calibrated(bench: &BenchConfig) -> BenchConfig {
    let unit = UnitConfig { sensor_offset_sd_cmh2o: 0.0, ..bench.unit };
    BenchConfig { unit, ..bench.clone() }
}
