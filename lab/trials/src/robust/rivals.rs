//! What a controller is compared with: the best PID of the family, the best PID of the plant itself, and the plant's bound.

use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use super::RobustError;
use super::plant_run::PlantRun;
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use progress::Progress;
use score::baselines::{Grid, Search, TuneError, tune_single_pid};
use score::bound::{BoundConfig, bounds};
use score::evaluate::Plan;

/// Plants on which the best single PID of a family is searched.
const TUNED_ON: u32 = 36;
/// Seed of these plants: apart from those that users choose, so that no PID is judged on the plants that it was tuned on.
pub const TUNING_SEED: u64 = u64::MAX;

/// A PID with these gains.
///
/// # Errors
/// Gains that no PID accepts.
pub fn pid(gains: PidGains) -> Result<Controller, RobustError> {
    Ok(Controller::Pid(Pid::new(gains, DEFAULT_PERIOD_US).map_err(TuneError::from)?))
}

/// The best single PID of a family: as its description says or, if it does not, searched on plants of the family.
///
/// # Errors
/// See [`tune_single_pid`].
pub fn family_pid(family: &Family, progress: &Progress<'_>) -> Result<PidGains, RobustError> {
    match family.pid {
        Some(gains) => Ok(gains),
        None => search_family_pid(family, progress),
    }
}

/// Searches the best single PID of a family, by the mean score over all its waveforms on 36 plants.
///
/// # Errors
/// See [`tune_single_pid`].
pub fn search_family_pid(family: &Family, progress: &Progress<'_>) -> Result<PidGains, RobustError> {
    let plants: Vec<BenchConfig> = (0..TUNED_ON).map(|number| family.draw(TUNING_SEED, number)).collect();
    let plan = Plan { pips: family.pips.clone(), settings: family.settings, ..Plan::tuning(0) };
    // A coarse grid with one refinement more ends at the same spacing in a sixth of the time.
    let search = Search { grid: Grid::coarse(), refinements: 4, exhaustive: false };
    Ok(tune_single_pid(&plants, &search, &plan, progress)?.pid.gains)
}

/// The best PID for this plant and its waveform. The coarse grid would end up to 5 % worse.
///
/// # Errors
/// See [`tune_single_pid`].
pub fn own_pid(run: &PlantRun) -> Result<PidGains, RobustError> {
    let plan = Plan { pips: vec![run.settings.pip], settings: run.settings, ..Plan::tuning(0) };
    let plant = std::slice::from_ref(&run.bench);
    Ok(tune_single_pid(plant, &Search::default(), &plan, &Progress::silent())?.pid.gains)
}

/// The plant's reference bound for its waveform, cmH2O.
///
/// # Errors
/// See [`bounds`].
pub fn bound(run: &PlantRun) -> Result<f64, RobustError> {
    let plan = Plan { pips: vec![run.settings.pip], settings: run.settings, ..Plan::default() };
    let benches = std::slice::from_ref(&run.bench);
    let found = bounds(benches, &plan, &BoundConfig::default(), &Progress::silent())?;
    Ok(found.iter().map(|bound| bound.mean.score).sum())
}
