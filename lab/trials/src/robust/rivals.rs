//! What a controller is compared with: the best PID of the family, the best PID of the plant itself, and the plant's bound.

use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use super::RobustError;
use super::plant_run::{PlantRun, SCORED};
use plant::bench::family::Family;
use plant::prescriptions::Prescriptions;
use progress::Progress;
use score::baselines::{Grid, Search, TuneError, tune_single_pid};
use score::bound::{BoundConfig, bounds};
use score::evaluate::{Plan, PrescribedBench};

/// Plants on which the best single PID of a family is searched, each with every listed waveform.
const TUNED_ON: u32 = 36;
/// The same, each with a prescription of its own.
const TUNED_ON_DRAWN: u32 = 72;
/// Seed of these plants: apart from those that users choose, so that no PID is judged on the plants that it was tuned on.
pub const TUNING_SEED: u64 = u64::MAX;

/// A PID with these gains.
///
/// # Errors
/// Gains that no PID accepts.
pub fn pid(gains: PidGains) -> Result<Controller, RobustError> {
    Ok(Controller::Pid(Pid::new(gains, DEFAULT_PERIOD_US).map_err(TuneError::from)?))
}

/// The best single PID of a family with these waveforms: as the family's description says or, if it does not, searched on plants of
/// the family.
///
/// # Errors
/// See [`tune_single_pid`].
pub fn family_pid(
    family: &Family,
    prescriptions: &Prescriptions,
    progress: &Progress<'_>,
) -> Result<PidGains, RobustError> {
    match known_pid(family, prescriptions) {
        Some(gains) => Ok(gains),
        None => search_family_pid(family, prescriptions, progress),
    }
}

/// The best single PID with these waveforms, as the family's description says; none if it does not.
pub fn known_pid(family: &Family, prescriptions: &Prescriptions) -> Option<PidGains> {
    let (listed, bedside) = (family.listed(), &family.bedside);
    let of = |known: Option<PidGains>, own: &Prescriptions| known.filter(|_| own == prescriptions);
    of(family.pid, &listed).or(of(family.bedside_pid, bedside))
}

/// Searches the best single PID of a family by the mean score over plants: over all waveforms that are listed on each of 36, or over
/// the own prescription of each of 72.
///
/// # Errors
/// See [`tune_single_pid`].
pub fn search_family_pid(
    family: &Family,
    prescriptions: &Prescriptions,
    progress: &Progress<'_>,
) -> Result<PidGains, RobustError> {
    let plan = Plan::tuning(0).prescribed(prescriptions, TUNING_SEED, 1);
    // A coarse grid with one refinement more ends at the same spacing in a sixth of the time.
    let search = Search { grid: Grid::coarse(), refinements: 4, exhaustive: false };
    let plant = |number| family.draw(TUNING_SEED, number);
    let best = if prescriptions.are_listed() {
        let plants: Vec<_> = (0..TUNED_ON).map(plant).collect();
        tune_single_pid(&plants, &search, &plan, progress)?
    } else {
        let prescription = |number| prescriptions.draw(TUNING_SEED, number);
        let plant = |n| PrescribedBench { bench: plant(n), prescription: prescription(n) };
        let plants: Vec<_> = (0..TUNED_ON_DRAWN).map(plant).collect();
        tune_single_pid(&plants, &search, &plan, progress)?
    };
    Ok(best.pid.gains)
}

/// The best PID for this plant and its waveform. The coarse grid would end up to 5 % worse.
///
/// # Errors
/// See [`tune_single_pid`].
pub fn own_pid(run: &PlantRun) -> Result<PidGains, RobustError> {
    let plan = Plan { waveforms: vec![run.settings], goes_on: run.goes_on, ..Plan::tuning(0) };
    let plant = std::slice::from_ref(&run.bench);
    Ok(tune_single_pid(plant, &Search::default(), &plan, &Progress::silent())?.pid.gains)
}

/// The plant's reference bound for each of the scored breaths, cmH2O. For drawn prescriptions, each breath has its own, from rest: a
/// lung that keeps gas fills from breath to breath.
///
/// # Errors
/// See [`bounds`].
pub fn bound(run: &PlantRun) -> Result<Vec<f64>, RobustError> {
    let scored = SCORED.into_iter().filter(|breath| *breath <= run.breaths);
    if run.goes_on {
        return scored.map(|breath| bound_of(run, Some(breath))).collect();
    }
    let periodic = bound_of(run, None)?;
    Ok(scored.map(|_| periodic).collect())
}

/// The bound of the breath with this number from rest; without it, of a breath after many of its kind.
fn bound_of(run: &PlantRun, breath: Option<u32>) -> Result<f64, RobustError> {
    let plan = Plan { waveforms: vec![run.settings], ..Plan::default() };
    let benches = std::slice::from_ref(&run.bench);
    let search = BoundConfig { breath, ..BoundConfig::default() };
    let found = bounds(benches, &plan, &search, &Progress::silent())?;
    Ok(found.iter().map(|bound| bound.mean.score).sum())
}
