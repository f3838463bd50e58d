//! The folder of one unit, and what is recorded into it.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use shared::breath::DEFAULT_PERIOD_US;
use shared::control::network::Network;

use super::*;
use crate::StudyError;
use data::workspace::WorkspaceError;
use learn::controller::shipped;
use progress::Event;
use ventilator::BenchSource;

fn small(seed: u64) -> CommissionRun {
    let mut run = CommissionRun { seed, ..CommissionRun::default() };
    run.collect.breaths = 10;
    run
}

fn alone<'a>(place: &Path, seed: u64, unit: &str, start: &'a Residual) -> Alone<'a> {
    let (run, folder) = (small(seed), Workspace::new(place));
    Alone { run, start, unit: unit.to_owned(), bench: None, folder }
}

#[test]
fn a_stopped_recording_is_kept_under_another_name_and_repeated() {
    let (place, adult) = (tempfile::tempdir().unwrap(), shipped::residual("adult").unwrap());
    let unit = alone(place.path(), 1, "unit 7", &adult);
    let (pid, config) = (unit.run.pid(DEFAULT_PERIOD_US).unwrap(), unit.run.collection(0));
    let lung = BenchConfig::paper(20.0, 20.0);
    let source =
        || BenchSource::new(&lung, pid.clone(), &config.settings, DEFAULT_PERIOD_US, config.seed).unwrap();
    let stop = AtomicBool::new(false);
    let at_three = |event: &Event<'_>| {
        stop.fetch_or(event.done >= 3, Ordering::Relaxed);
    };
    let stopped = unit.record(&mut source(), &Progress::new(&at_three, &stop)).unwrap_err();
    assert!(matches!(stopped, StudyError::Pipeline(PipelineError::Stopped)), "{stopped}");
    assert_eq!(Recording::load(place.path().join(PARTIAL)).unwrap().inspirations().len(), 3);
    assert!(unit.recorded().unwrap().is_none());
    let whole = unit.record(&mut source(), &Progress::silent()).unwrap();
    assert_eq!((whole.inspirations().len(), unit.recorded().unwrap()), (10, Some(whole)));
}

#[test]
fn a_folder_of_another_unit_seed_or_controller_is_refused() {
    let (place, adult) = (tempfile::tempdir().unwrap(), shipped::residual("adult").unwrap());
    let blank = Residual::new(*adult.spec(), Network::zero()).unwrap();
    let claim = |seed, unit, start| alone(place.path(), seed, unit, start).claim();
    claim(1, "unit 7", &adult).unwrap();
    claim(1, "unit 7", &adult).unwrap();
    for (refused, what) in [
        (claim(1, "unit 8", &adult), "`unit` is \"unit 7\" there and \"unit 8\" here"),
        (claim(2, "unit 7", &adult), "`seed` is 1 there and 2 here"),
        (claim(1, "unit 7", &blank), "`start` is "),
    ] {
        match refused {
            Err(StudyError::Workspace(WorkspaceError::OtherRun { difference, .. })) => {
                assert!(difference.contains(what), "{difference}");
            }
            other => panic!("{other:?}"),
        }
    }
}
