//! Tests of the robustness test.

use super::plant_run::{BreathScore, PlantBreaths};
use super::*;
use campaign::{Campaign, Sums};
use progress::Progress;
use score::evaluate::ValveEffort;
use shared::control::pid::KNOWN_GOOD;

const SOUND: PidGains = PidGains { p: 6.0, i: 290.0, d: 0.2 };

fn family() -> Family {
    Family::find("adult").unwrap()
}

fn question(breaths: u32, subset: u32) -> Question {
    Question {
        family: "adult".to_owned(),
        first_plant: family().draw(1, 0),
        controller: "PID".to_owned(),
        family_pid: KNOWN_GOOD,
        seed: 1,
        prescriptions: Prescriptions::default(),
        breaths,
        subset,
    }
}

type Test = Campaign<Question, Tally>;

/// A test of some plants, or the continuation of an earlier one.
fn tested(question: &Question, earlier: Option<Test>, plants: u64) -> Test {
    let (family, controller) = (family(), rivals::pid(SOUND).unwrap());
    let work = Robustness {
        question: question.clone(),
        family: &family,
        controller: &controller,
        failure: &|| None,
    };
    let mut test = earlier.unwrap_or_else(|| Campaign::new(&work));
    test.advance(&work, plants, None, &Progress::silent()).unwrap();
    test
}

fn breath(score: f64) -> BreathScore {
    let effort = ValveEffort { total_variation: 100.0 * score, deviation: 3.0 * score };
    BreathScore { score, overshoot: 2.0 * score, effort }
}

/// Six breaths, of which the first and the last are scored. All but the last score 1.
fn run(last: f64) -> PlantBreaths {
    let mut every = vec![1.0; 6];
    every[5] = last;
    PlantBreaths { every, scored: vec![breath(1.0), breath(last)], unstable: false, cut: false }
}

/// A run that ended in the safe state before its second breath.
fn stopped() -> PlantBreaths {
    PlantBreaths { every: vec![1.0], scored: vec![breath(1.0)], unstable: false, cut: false }
}

/// A result with these scores of the last breath.
fn result(number: u32, controller: f64, family: f64, rivals: Option<(f64, f64)>) -> PlantResult {
    let rivals = rivals.map(|(own, bound)| Rivals { own: run(own).scored, bound: vec![bound; 2] });
    PlantResult { number, controller: run(controller), family: run(family), rivals }
}

fn summary(results: &[PlantResult]) -> Summary {
    let tally = |results: &[PlantResult]| {
        let mut tally = Tally::new(6, 2);
        for result in results {
            tally.add(u64::from(result.number), result.clone());
        }
        tally
    };
    // Two parts, the later one first: whatever a test expects, it expects of divided sums as well.
    let (one, other) = results.split_at(results.len() / 2);
    let mut parts = tally(other);
    parts.absorb(tally(one));
    assert_eq!(parts, tally(results));
    Summary::of_plants(results.len() as u32, &parts)
}

#[track_caller]
fn near(value: f64, wanted: f64) {
    assert!((value - wanted).abs() < 1e-9, "{value}, not {wanted}");
}

#[test]
fn scores_are_compared_plant_by_plant_with_each_rival() {
    let found = summary(&[
        result(0, 1.0, 1.0, Some((0.9, 0.5))),
        result(1, 2.0, 3.0, Some((2.0, 1.0))),
        result(2, 3.0, 2.0, None),
    ]);
    assert_eq!((found.plants, found.subset, found.stopped), (3, 2, 0));
    assert_eq!(found.breaths, [1, 6]);
    near(found.mean[1], 2.0);
    near(found.family_pid[1], 2.0);
    near(found.share_not_worse[1], 2.0 / 3.0);
    assert_eq!((found.own_not_worse[1], found.bound_ratio[1]), (Some(0.5), Some(2.0)));
    assert_eq!((found.own_pid[1], found.bound[1]), (Some(1.45), Some(0.75)));
    assert_eq!(found.bound_ratio_each[1], Some(2.0));
    near(found.overshoot_median[1], 4.01);
    near(found.overshoot_p99[1], 6.01);
    near(found.scores[1].unwrap().median, 2.01);
    near(found.ratios[1].unwrap().p1, 0.67);
    near(found.own_ratios[1].unwrap().p99, 1.12);
    let ratios: Vec<_> = found.worst.iter().map(|plant| (plant.number, plant.ratio)).collect();
    assert_eq!(ratios, [(2, 1.5), (0, 1.0), (1, 2.0 / 3.0)]);
}

#[test]
fn a_plant_on_which_the_ventilator_stops_is_worse_than_every_rival() {
    let own_stopped = PlantResult { controller: stopped(), ..result(0, 1.0, 1.0, Some((1.0, 1.0))) };
    let rival_stopped = PlantResult { family: stopped(), ..result(1, 1.0, 1.0, Some((1.0, 0.5))) };
    let found = summary(&[own_stopped.clone(), rival_stopped, own_stopped]);
    assert_eq!((found.stopped, found.family_stopped), (2, 1));
    near(found.share_not_worse[1], 1.0 / 3.0);
    assert_eq!((found.own_not_worse[1], found.bound_ratio[1]), (Some(1.0 / 3.0), Some(2.0)));
    near(found.mean[1], 0.0);
    assert_eq!(found.worst, []);
}

#[test]
fn the_mean_of_every_breath_shows_what_is_learned() {
    let found = summary(&[result(0, 0.5, 1.0, None), result(1, 0.7, 2.0, None)]);
    assert_eq!(found.mean_by_breath[..5], [1.0; 5]);
    near(found.mean_by_breath[5], 0.6);
    near(found.family_pid_by_breath[5], 1.5);
}

#[test]
fn valve_effort_is_a_mean_beside_that_of_the_familys_pid() {
    let found = summary(&[result(0, 1.0, 2.0, None), result(1, 2.0, 4.0, None)]);
    near(found.effort[1].total_variation, 150.0);
    near(found.effort[1].deviation, 4.5);
    near(found.family_effort[1].total_variation, 300.0);
    near(found.family_effort[1].deviation, 9.0);
}

#[test]
fn a_later_breath_may_be_worse_by_the_larger_of_a_share_and_a_pressure() {
    let worsened = |first: f64, later: f64| {
        PlantBreaths { every: vec![first, first, later, first], ..PlantBreaths::default() }.worsened()
    };
    assert!(!worsened(1.0, 1.299) && worsened(1.0, 1.301), "0.3 cmH2O");
    assert!(!worsened(10.0, 10.499) && worsened(10.0, 10.501), "5 %");
    assert!(!PlantBreaths::default().worsened());
    let found = summary(&[result(0, 1.4, 1.0, None), result(1, 1.0, 1.4, None), result(2, 1.0, 1.4, None)]);
    near(found.worsened, 1.0 / 3.0);
    near(found.family_worsened, 2.0 / 3.0);
}

#[test]
fn a_loop_that_rings_is_unstable_and_a_lung_that_still_fills_is_not() {
    let unstable = |bench: BenchConfig, gains| {
        let run = PlantRun { bench, ..PlantRun::new(&family(), &Prescriptions::default(), 1, 3, 2) };
        breaths(&run, &rivals::pid(gains).unwrap()).unwrap().unstable
    };
    let mut slow = BenchConfig::paper(5.0, 100.0);
    slow.valve.max_flow_l_per_s = 1.0;
    assert!(!unstable(slow, KNOWN_GOOD));
    assert!(!unstable(BenchConfig::paper(20.0, 20.0), KNOWN_GOOD));
    let mut delayed = BenchConfig::paper(50.0, 50.0);
    delayed.valve.dead_time_ms = 20.0;
    assert!(unstable(delayed, PidGains { p: 10.0, i: 200.0, d: 0.0 }));
}

#[test]
fn only_the_ten_worst_plants_are_kept() {
    let results: Vec<_> = (0..30).map(|number| result(number, f64::from(number), 1.0, None)).collect();
    let numbers: Vec<_> = summary(&results).worst.iter().map(|plant| plant.number).collect();
    assert_eq!(numbers, (20..30).rev().collect::<Vec<_>>());
}

#[test]
fn without_a_subset_nothing_is_said_about_it() {
    let found = summary(&[result(0, 1.0, 1.0, None)]);
    assert_eq!((found.subset, found.own_not_worse[1], found.bound_ratio[1]), (0, None, None));
}

#[test]
fn a_test_that_continues_ends_like_one_that_was_not_stopped() {
    let question = question(2, 0);
    let whole = tested(&question, None, 150);
    assert_eq!(whole, tested(&question, Some(tested(&question, None, 70)), 150));
    let summary = Summary::of(&whole);
    assert_eq!((summary.plants, summary.breaths), (150, vec![1]));
}

#[test]
fn the_plants_own_pid_beats_that_of_others_and_no_pid_beats_the_bound() {
    let found = Summary::of(&tested(&question(6, 2), None, 2));
    assert_eq!(found.subset, 2);
    assert!(found.bound_ratio.iter().all(|ratio| ratio.is_some_and(|ratio| ratio > 1.0)), "{found:?}");
    let run = PlantRun::new(&family(), &Prescriptions::default(), 1, 0, 6);
    let last = |gains| breaths(&run, &rivals::pid(gains).unwrap()).unwrap().scored[1].score;
    assert!(last(rivals::own_pid(&run).unwrap()) <= last(SOUND));
}

#[test]
fn plants_take_turns_at_the_papers_waveforms_and_have_noise_of_their_own() {
    let runs: Vec<_> =
        (0..7).map(|number| PlantRun::new(&family(), &Prescriptions::default(), 1, number, 1)).collect();
    let pips: Vec<_> = runs.iter().map(|run| run.settings.pip).collect();
    assert_eq!(pips, [10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 10.0]);
    assert_ne!(runs[0].noise, runs[6].noise);
}

fn bedside() -> Prescriptions {
    family().bedside
}

#[test]
fn plants_have_prescriptions_of_their_own_and_go_on_at_the_pressure_limit() {
    let (family, bedside) = (family(), bedside());
    let run = |number| PlantRun::new(&family, &bedside, 1, number, 2);
    assert_eq!(run(3).settings, bedside.draw(1, 3));
    assert_eq!(run(3).bench, family.draw(1, 3));
    let wild = rivals::pid(PidGains { p: 80.0, i: 5000.0, d: 0.0 }).unwrap();
    let found: Vec<_> = (0..20).map(|number| breaths(&run(number), &wild).unwrap()).collect();
    let cut = found.iter().find(|found| found.cut).expect("an inspiration that the limit ended");
    assert_eq!((cut.every.len(), cut.scored.len()), (2, 1), "the ventilation goes on");
    let calm = rivals::pid(PidGains::default()).unwrap();
    assert!((0..20).all(|number| !breaths(&run(number), &calm).unwrap().cut));
}

#[test]
fn drawn_prescriptions_are_scored_finitely_and_are_another_question() {
    let drawn = Question { prescriptions: bedside(), ..question(2, 0) };
    let found = Summary::of(&tested(&drawn, None, 60));
    assert_eq!(found.plants, 60);
    let figures = [found.mean[0], found.family_pid[0], found.overshoot_p99[0], found.mean_by_breath[1]];
    assert!(figures.iter().all(|figure| figure.is_finite() && *figure > 0.0), "{figures:?}");
    assert_ne!(drawn, question(2, 0));
    let text = serde_json::to_string(&drawn).unwrap();
    assert_eq!(serde_json::from_str::<Question>(&text).unwrap(), drawn);
}

#[test]
fn each_distribution_has_a_best_pid_of_its_own() {
    let family = family();
    assert_eq!(rivals::known_pid(&family, &family.listed()), family.pid);
    assert_eq!(rivals::known_pid(&family, &family.bedside), family.bedside_pid);
    assert!(family.pid.is_some() && family.bedside_pid.is_some() && family.pid != family.bedside_pid);
    let other = Prescriptions { square_share: 0.9, ..bedside() };
    assert_eq!(rivals::known_pid(&family, &other), None);
}
