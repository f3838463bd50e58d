//! The parts of the supervisor, which are its monitors and responses, and the row of the fault matrix that needs each of them.

use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::safety::responses::Response;

use super::cases::{FaultCase, LIMIT};
use super::matrix::{FAULTS, FaultRow, SoundRuns, cell, cells};
use plant::bench::BenchConfig;
use progress::{Progress, Task};
use score::evaluate::side_by_side;
use ventilator::SourceError;

/// What can be left out of the monitors and responses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The monitor of a fault.
    Monitor(Fault),
    /// A response.
    Response(Response),
}

impl Part {
    /// All monitors and all responses.
    pub fn all() -> impl Iterator<Item = Self> {
        Fault::all().map(Self::Monitor).chain(Response::ALL.into_iter().map(Self::Response))
    }

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Monitor(fault) => fault.alarm().id,
            Self::Response(response) => response.name(),
        }
    }

    /// All other monitors and responses.
    pub fn others(self) -> Monitors {
        match self {
            Self::Monitor(fault) => Monitors::ALL.without(fault),
            Self::Response(response) => Monitors::ALL.without_response(response),
        }
    }

    /// Whether a case requires this monitor's alarm, so that its row must fail without it.
    fn is_required_by(self, case: &FaultCase) -> bool {
        matches!(self, Self::Monitor(fault) if case.monitors.contains(&fault))
    }
}

/// Leaves out each monitor and each response in turn; returns a row that then fails, or none, in which case the part is
/// unproven.
///
/// One failing row is enough, so the search for it starts with the rows that require the part's alarm and ends at the first
/// failure. Only an unproven part takes a whole matrix.
///
/// # Errors
/// See [`matrix`](super::matrix::matrix).
pub fn without_each_part(
    lungs: &[BenchConfig],
    seeds: &[u64],
    progress: &Progress<'_>,
) -> Result<Vec<(Part, Option<FaultRow>)>, SourceError> {
    let parts: Vec<Part> = Part::all().collect();
    let task = progress.task(FAULTS, parts.len());
    let sound = SoundRuns::default();
    side_by_side(&parts, &task, |part| Ok((*part, failing_row(*part, lungs, seeds, &sound, &task)?)))
}

/// The first row that fails without a part, in the order of the search.
fn failing_row(
    part: Part,
    lungs: &[BenchConfig],
    seeds: &[u64],
    sound: &SoundRuns,
    task: &Task<'_>,
) -> Result<Option<FaultRow>, SourceError> {
    for (case, lung) in search_order(part, lungs) {
        if task.stopped() {
            return Err(SourceError::Stopped);
        }
        let row = cell(case, lung, seeds, (LIMIT, part.others()), sound)?;
        if !row.pass {
            return Ok(Some(row));
        }
    }
    Ok(None)
}

/// All cells of the matrix: first those that require the part's alarm, then all cases on one lung after the other.
fn search_order(part: Part, lungs: &[BenchConfig]) -> Vec<(&'static FaultCase, &BenchConfig)> {
    let one_by_one = lungs.iter().flat_map(|lung| cells(std::slice::from_ref(lung)));
    let (mut order, rest): (Vec<_>, Vec<_>) = one_by_one.partition(|(case, _)| part.is_required_by(case));
    order.extend(rest);
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lungs() -> [BenchConfig; 2] {
        [BenchConfig::paper(5.0, 10.0), BenchConfig::paper(20.0, 20.0)]
    }

    /// The fault of the row that proves a part on a lung.
    fn proof(part: Part, lung: &BenchConfig) -> Option<&'static str> {
        let (sound, lungs) = (SoundRuns::default(), std::slice::from_ref(lung));
        let task = Progress::silent().task(FAULTS, 1);
        failing_row(part, lungs, &[1], &sound, &task).unwrap().map(|row| row.fault)
    }

    #[test]
    fn the_search_for_every_part_includes_every_cell_of_the_matrix_once() {
        let lungs = lungs();
        let names = |cells: Vec<(&FaultCase, &BenchConfig)>| {
            let mut names: Vec<_> = cells.iter().map(|(case, lung)| (case.name, lung.name.clone())).collect();
            names.sort_unstable();
            names
        };
        let matrix = names(cells(&lungs).collect());
        assert!(Part::all().all(|part| names(search_order(part, &lungs)) == matrix));
    }

    #[test]
    fn the_search_starts_with_the_rows_that_require_the_alarm() {
        let lungs = lungs();
        let order = search_order(Part::Monitor(Fault::ReadingFrozen), &lungs);
        let required: Vec<_> =
            order.iter().map(|(case, _)| case.monitors.contains(&Fault::ReadingFrozen)).collect();
        assert_eq!(required.iter().filter(|required| **required).count(), 6);
        assert!(required.is_sorted_by(|earlier, later| earlier >= later));
    }

    #[test]
    fn a_part_is_proven_by_a_row_of_another_alarm_if_none_requires_its_own() {
        let part = Part::Response(Response::OtherSensor);
        assert_eq!(proof(part, &lungs()[1]), Some("reading stuck at its last value"));
    }

    #[test]
    fn a_part_that_no_row_needs_is_unproven() {
        // The row that proves it is impossible with this lung's low resistance.
        assert_eq!(proof(Part::Response(Response::CappedPid), &lungs()[0]), None);
    }
}
