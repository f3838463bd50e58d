//! Searches on small grids with short plans.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::ThreadPoolBuilder;
use shared::control::Controller;
use shared::control::pid::Pid;
use shared::settings::Settings;

use super::*;
use crate::evaluate::{at_pips, evaluate};
use plant::bench::BenchConfig;
use progress::Event;

fn lung(resistance: f64, compliance: f64) -> BenchConfig {
    BenchConfig::paper(resistance, compliance)
}

/// A plan with one scored breath of two waveforms.
fn short() -> Plan {
    Plan { waveforms: at_pips(&[15.0, 30.0], &Settings::default()), breaths: 1, ..Plan::tuning(0) }
}

/// A grid of 8 x 8 x 2 points, more than pass the screening.
fn small() -> Search {
    Search {
        grid: Grid {
            p: vec![0.0, 0.3, 0.6, 1.0, 1.5, 2.5, 5.0, 10.0],
            i: vec![0.0, 5.0, 10.0, 20.0, 40.0, 60.0, 100.0, 200.0],
            d: vec![0.0, 0.02],
        },
        refinements: 0,
        exhaustive: false,
    }
}

fn tune(benches: &[BenchConfig], search: &Search) -> TuneResult {
    tune_pid(benches, search, &short(), &Progress::silent()).unwrap()
}

fn score(bench: &BenchConfig, gains: PidGains) -> f64 {
    let plan = short();
    let pid = Controller::Pid(Pid::new(gains, plan.period_us).unwrap());
    evaluate(bench, &pid, &plan).unwrap().mean.score
}

#[test]
fn the_best_of_a_tiny_grid_is_the_one_that_evaluates_best() {
    let bench = lung(20.0, 20.0);
    let search = Search { grid: Grid { p: vec![0.5, 2.0], i: vec![5.0, 40.0], d: vec![] }, ..small() };
    let mut by_hand: Vec<(f64, PidGains)> =
        search.grid.completed().points().into_iter().map(|gains| (score(&bench, gains), gains)).collect();
    by_hand.sort_by(|(one, _), (other, _)| one.total_cmp(other));
    let best = tune(&[bench], &search).lungs[0].best;
    assert_eq!((best.pi.score, best.pi.gains), by_hand[0]);
    assert_eq!(best.pid, best.pi, "without a derivative in the grid");
}

#[test]
fn screening_finds_what_the_exhaustive_search_finds() {
    let exhaustive = Search { exhaustive: true, ..small() };
    for bench in [lung(20.0, 20.0), lung(5.0, 10.0), lung(50.0, 20.0)] {
        let benches = [bench];
        let (screened, all) = (tune(&benches, &small()), tune(&benches, &exhaustive));
        assert_eq!(screened.lungs[0].best, all.lungs[0].best, "{}", benches[0].name);
    }
}

#[test]
fn a_kind_never_scores_worse_than_one_that_it_includes() {
    let best = tune(&[lung(20.0, 20.0)], &small()).lungs[0].best;
    assert!(best.pid.score <= best.pi.score);
    assert!(best.pi.score <= best.p_only.score && best.pi.score <= best.i_only.score);
    for kind in PidKind::ALL {
        assert!(kind.includes(&best.of(kind).gains), "{}", kind.name());
    }
}

#[test]
fn refinement_leaves_the_grid_for_the_better() {
    let coarse = Search { grid: Grid { p: vec![0.5, 4.0], i: vec![10.0, 100.0], d: vec![] }, ..small() };
    let fine = Search { refinements: 2, ..coarse.clone() };
    let benches = [lung(20.0, 20.0)];
    let (on_grid, off_grid) = (tune(&benches, &coarse), tune(&benches, &fine));
    assert!(off_grid.lungs[0].best.pi.score < on_grid.lungs[0].best.pi.score);
    let found = off_grid.lungs[0].best.pi;
    assert_eq!(
        found.score.to_bits(),
        score(&benches[0], found.gains).to_bits(),
        "a refined score is a full one"
    );
}

#[test]
fn one_gain_for_all_lungs_is_a_compromise_by_their_mean() {
    let benches = [lung(5.0, 20.0), lung(50.0, 20.0)];
    let result = tune(&benches, &small());
    let single = result.over_all.pi;
    let mean = benches.iter().map(|bench| score(bench, single.gains)).sum::<f64>() / 2.0;
    assert!((single.score - mean).abs() < 1e-12);
    let own = result.lungs.iter().map(|lung| lung.best.pi.score).sum::<f64>() / 2.0;
    assert!(single.score >= own, "{} >= {own}", single.score);
    assert_eq!(result.lungs[1].lung, "R50C20");
}

#[test]
fn one_lung_alone_is_all_lungs() {
    let result = tune(&[lung(20.0, 20.0)], &small());
    assert_eq!(result.over_all, result.lungs[0].best);
}

#[test]
fn the_number_of_threads_does_not_change_the_result() {
    let search = Search {
        grid: Grid { p: vec![0.5, 2.0], i: vec![5.0, 40.0], d: vec![0.01] },
        refinements: 1,
        ..small()
    };
    let with = |threads| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| tune(&[lung(20.0, 20.0)], &search))
    };
    assert_eq!(with(1), with(2));
}

#[test]
fn gains_that_lead_to_a_fault_score_worst_and_do_not_end_the_search() {
    let plan = Plan {
        waveforms: at_pips(&[30.0], &Settings { pressure_limit: 35.0, ..Settings::default() }),
        ..short()
    };
    let search = Search {
        grid: Grid { p: vec![0.5, 80.0], i: vec![0.0, 10_000.0], d: vec![] },
        exhaustive: true,
        ..small()
    };
    // With a slow valve and a stiff lung, the pressure is far above the limit before the valve has closed.
    let mut stiff = lung(5.0, 3.0);
    stiff.valve.dead_time_ms = 60.0;
    let result = tune_pid(&[stiff], &search, &plan, &Progress::silent()).unwrap();
    let LungResult { best, map, .. } = &result.lungs[0];
    assert_eq!(map.score[2][1], Some(FAULT_SCORE), "P 80, I 10000");
    assert!(best.pid.score < 20.0);
}

#[test]
fn stopped_at_once_there_is_still_a_result() {
    let stop = AtomicBool::new(true);
    let result = tune_pid(&[lung(20.0, 20.0)], &small(), &short(), &Progress::quiet(&stop)).unwrap();
    assert!(!result.complete && !result.lungs[0].complete);
    assert_eq!(result.over_all.pid.gains, PidGains::default());
    assert!(result.lungs[0].map.score.iter().flatten().all(Option::is_none));
}

#[test]
fn stopped_on_the_way_the_best_so_far_comes_back() {
    let stop = AtomicBool::new(false);
    let after_half = |event: &Event<'_>| {
        if event.done > 200 {
            stop.store(true, Ordering::Relaxed);
        }
    };
    let benches = [lung(20.0, 20.0)];
    let result = tune_pid(&benches, &small(), &short(), &Progress::new(&after_half, &stop)).unwrap();
    assert!(!result.complete);
    let found = result.lungs[0].best.pid;
    assert!(found.score < score(&benches[0], PidGains::default()));
    assert_eq!(found.score.to_bits(), score(&benches[0], found.gains).to_bits());
}

#[test]
fn a_whole_search_is_complete_and_reports_all_of_its_work() {
    let seen = Mutex::new(Vec::new());
    let note = |event: &Event<'_>| seen.lock().unwrap().push((event.done, event.total));
    let stop = AtomicBool::new(false);
    let progress = Progress::new(&note, &stop);
    let result = tune_pid(&[lung(20.0, 20.0)], &small(), &short(), &progress).unwrap();
    assert!(result.complete && result.lungs[0].complete);
    let seen = seen.into_inner().unwrap();
    assert!(seen.iter().all(|(done, total)| done <= total));
    let (done, total) = seen[seen.len() - 1];
    assert_eq!(done, total);
}

#[test]
fn what_cannot_be_searched_is_refused() {
    let silent = Progress::silent();
    let none = tune_pid::<BenchConfig>(&[], &small(), &short(), &silent);
    assert!(matches!(none, Err(TuneError::NoLung)));
    let negative = Search { grid: Grid { p: vec![-1.0], i: vec![], d: vec![] }, ..small() };
    let refused = tune_pid(&[lung(20.0, 20.0)], &negative, &short(), &silent);
    assert!(matches!(refused, Err(TuneError::Gain(GainError { name: "p", .. }))));
    let impossible = Plan { waveforms: at_pips(&[500.0], &Settings::default()), ..short() };
    let refused = tune_pid(&[lung(20.0, 20.0)], &small(), &impossible, &silent);
    assert!(matches!(refused, Err(TuneError::Source(SourceError::Settings(_)))));
}
