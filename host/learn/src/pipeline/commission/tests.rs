//! Commissioning at a small size.

use std::sync::atomic::{AtomicBool, Ordering};

use shared::breath::DEFAULT_PERIOD_US;
use shared::explore::Exploration;

use super::*;
use crate::controller::shipped;
use crate::pipeline::tests::score;
use plant::bench::BenchConfig;
use progress::Event;
use ventilator::BenchSource;
use ventilator::collect::collect;

fn small() -> CommissionRun {
    let mut run = CommissionRun { parts: 2, drawn: (64, 32), ..CommissionRun::default() };
    run.collect.breaths = 10;
    run.fit.epochs = 120;
    run.train.iterations = 30;
    run.train.batch = 64;
    run.train.validate_every = 10;
    run
}

/// A machine at the ends of the adult family's ranges: late, with a fast actuator and a strongly curved valve.
fn unlike_the_nominal_one() -> BenchConfig {
    let mut bench = BenchConfig { name: "late".into(), ..BenchConfig::paper(20.0, 20.0) };
    (bench.valve.dead_time_ms, bench.valve.lag_ms, bench.valve.curve_exponent) = (20.0, 15.0, 1.7);
    bench
}

fn adult() -> Residual {
    shipped::residual("adult").unwrap()
}

fn recording(run: &CommissionRun) -> Recording {
    recorded(run, &unlike_the_nominal_one())
}

fn recorded(run: &CommissionRun, bench: &BenchConfig) -> Recording {
    let (pid, config) = (run.pid(DEFAULT_PERIOD_US).unwrap(), run.collection(0));
    let mut source =
        BenchSource::new(bench, pid.clone(), &config.settings, DEFAULT_PERIOD_US, config.seed).unwrap();
    collect(&mut source, &pid, &config, &Progress::silent()).unwrap().recording
}

fn commissioned(run: &CommissionRun) -> Commissioned {
    let checked = run.check(&recording(run), &Progress::silent()).unwrap();
    assert_eq!(checked.figures.problem(), None, "{:?}", checked.figures);
    run.tune(&adult(), &[&checked.simulator], None, &Progress::silent()).unwrap()
}

#[test]
fn a_commissioned_controller_beats_the_familys_on_a_machine_unlike_the_nominal_one() {
    let Commissioned { learned, winner, start, complete, .. } = commissioned(&small());
    assert!(winner == Winner::FineTuned && complete && learned.origin.validation < start);
    assert_eq!(learned.controller.spec(), adult().spec());
    let bench = unlike_the_nominal_one();
    let on_bench = |controller| score(&bench, &Controller::Residual(controller));
    let (before, after) = (on_bench(adult()), on_bench(learned.controller));
    assert!(after < 0.99 * before, "before {before:.3}, after {after:.3}");
}

#[test]
fn a_breath_with_a_lost_row_is_left_out_and_does_not_count_as_ended() {
    let run = small();
    let whole = recording(&run);
    let mut lost = whole.clone();
    let first = lost.breaths()[0].clone();
    lost.tick[first.start + 10..first.end].iter_mut().for_each(|tick| *tick += 1);
    let breaths = |recording| run.check(recording, &Progress::silent()).unwrap().figures.breaths;
    assert_eq!(breaths(&lost), breaths(&whole) - 1);
}

#[test]
fn the_same_seed_gives_the_same_weights_on_any_number_of_threads() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| commissioned(&small()).learned)
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_ne!(one, commissioned(&CommissionRun { seed: 2, ..small() }).learned);
}

#[test]
fn the_simulator_finds_the_valves_times_of_the_unit() {
    let run = small();
    let unit = run.check(&recording(&run), &Progress::silent()).unwrap().figures.unit;
    assert!((unit.dead_time_ms - 20.0).abs() < 3.0 && (unit.lag_ms - 15.0).abs() < 4.0, "{unit:?}");
}

#[test]
fn a_training_that_does_not_improve_returns_the_starting_controller() {
    let mut run = small();
    // Steps large enough to ruin the network immediately.
    run.train.adam.rate = 1.0e2;
    (run.train.iterations, run.train.validate_every) = (2, 2);
    let Commissioned { learned, winner, start, .. } = commissioned(&run);
    assert_eq!((winner, &learned.controller), (Winner::Start, &adult()));
    assert!((learned.origin.validation - start).abs() < 1e-12);
}

#[test]
fn a_recording_that_is_too_short_is_refused_with_what_to_do() {
    let mut run = small();
    run.collect.breaths = BREATHS_NEEDED - 1;
    let refused = run.check(&recording(&run), &Progress::silent()).unwrap_err().to_string();
    assert!(refused.contains("only 7") && refused.contains("raise --breaths"), "{refused}");
}

#[test]
fn a_unit_that_the_simulator_does_not_describe_is_not_commissioned() {
    let run = small();
    let good = run.check(&recording(&run), &Progress::silent()).unwrap().figures;
    let problem = |change: fn(&mut Figures)| {
        let mut figures = good;
        change(&mut figures);
        figures.problem().map(|problem| problem.to_string()).unwrap_or_default()
    };
    assert_eq!(problem(|_| ()), "");
    assert!(problem(|figures| figures.open_loop = 0.7).contains("is 0.70 cmH2O, more than 0.6"));
    assert!(problem(|figures| figures.open_loop = f64::NAN).contains("does not describe"));
}

#[test]
fn a_breath_that_the_pressure_limit_ends_ends_the_recording_which_is_refused_with_what_to_do() {
    let mut run = small();
    run.collector = PidGains { p: 1.0, i: 10.0, d: 0.0 };
    run.collect.breaths = 20;
    run.collect.settings.pressure_limit = 42.0;
    run.collect.exploration = Some(Exploration {
        boundary_probability: 0.5,
        boundary_height: (95.0, 100.0),
        boundary_duration: (0.3, 0.3),
        ..Exploration::default()
    });
    let recording = recorded(&run, &BenchConfig::paper(50.0, 10.0));
    assert_eq!(recording.breaths().len() - recording.inspirations().len(), 1);
    let refused = run.check(&recording, &Progress::silent()).unwrap_err();
    assert!(refused.to_string().contains("check the lung"), "{refused}");
}

#[test]
fn a_stopped_check_is_repeated_and_a_stopped_training_goes_on() {
    let run = small();
    let place = tempfile::tempdir().unwrap();
    let folder = Workspace::new(place.path());
    let stop = AtomicBool::new(false);
    let at_ten = |event: &Event<'_>| {
        stop.fetch_or(event.done >= 10, Ordering::Relaxed);
    };
    let stopping = Progress::new(&at_ten, &stop);
    let recording = recording(&run);
    let unit = run.check(&recording, &Progress::silent()).unwrap().simulator;
    assert!(matches!(run.check(&recording, &stopping), Err(PipelineError::Stopped)));
    stop.store(false, Ordering::Relaxed);
    let half = run.tune(&adult(), &[&unit], Some(&folder), &stopping).unwrap();
    assert_eq!((half.complete, half.curve.len()), (false, 1));
    let resumed = run.tune(&adult(), &[&unit], Some(&folder), &Progress::silent()).unwrap();
    assert_eq!(resumed.learned, commissioned(&run).learned);
}
