//! Tests of the robustness test.

use super::plant_run::BreathScore;
use super::*;
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
        breaths,
        subset,
    }
}

fn advanced(mut test: Robustness, plants: u32) -> Robustness {
    test.advance(plants, &family(), &rivals::pid(SOUND).unwrap(), None, &Progress::silent()).unwrap();
    test
}

fn breath(score: f64) -> BreathScore {
    BreathScore { score, overshoot: 2.0 * score }
}

/// A result with these scores of the last of two scored breaths.
fn result(number: u32, controller: f64, family: f64, rivals: Option<(f64, f64)>) -> PlantResult {
    PlantResult {
        number,
        controller: vec![breath(1.0), breath(controller)],
        family: vec![breath(1.0), breath(family)],
        rivals: rivals.map(|(own, bound)| Rivals { own: vec![breath(1.0), breath(own)], bound }),
    }
}

fn summary(results: &[PlantResult]) -> Summary {
    let mut test = Robustness::new(question(6, 0));
    for result in results {
        test.add(result);
        test.done += 1;
    }
    test.summary()
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
    assert!(
        (3.95..=4.1).contains(&found.overshoot_median[1]) && (5.95..=6.1).contains(&found.overshoot_p99[1])
    );
    let ratios: Vec<_> = found.worst.iter().map(|plant| (plant.number, plant.ratio)).collect();
    assert_eq!(ratios, [(2, 1.5), (0, 1.0), (1, 2.0 / 3.0)]);
}

#[test]
fn a_plant_on_which_the_ventilator_stops_is_worse_than_every_rival() {
    let stopped = PlantResult { controller: vec![breath(1.0)], ..result(0, 1.0, 1.0, Some((1.0, 1.0))) };
    let rival_stopped = PlantResult { family: vec![breath(1.0)], ..result(1, 1.0, 1.0, Some((1.0, 0.5))) };
    let found = summary(&[stopped, rival_stopped]);
    assert_eq!(found.stopped, 1);
    near(found.share_not_worse[1], 0.5);
    assert_eq!((found.own_not_worse[1], found.bound_ratio[1]), (Some(0.5), Some(2.0)));
    near(found.mean[1], 0.0);
    assert_eq!(found.worst, []);
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
    let whole = advanced(Robustness::new(question(2, 0)), 150);
    let parts = advanced(advanced(Robustness::new(question(2, 0)), 70), 150);
    assert_eq!(whole, parts);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(whole, pool.install(|| advanced(Robustness::new(question(2, 0)), 150)));
    assert_eq!((whole.summary().plants, whole.summary().breaths), (150, vec![1]));
}

#[test]
fn a_kept_test_is_continued_by_the_same_question_only() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("kept.json");
    let mut test = Robustness::new(question(1, 0));
    let controller = rivals::pid(SOUND).unwrap();
    test.advance(3, &family(), &controller, Some(&file), &Progress::silent()).unwrap();
    assert_eq!(Robustness::new(question(1, 0)).resumed(&file).unwrap(), test);
    let other = Robustness::new(Question { seed: 2, ..question(1, 0) }).resumed(&file);
    assert!(
        other
            .unwrap_err()
            .to_string()
            .contains("belongs to another family, seed, controller or number of breaths")
    );
}

#[test]
fn the_plants_own_pid_beats_that_of_others_and_no_pid_beats_the_bound() {
    let found = advanced(Robustness::new(question(6, 2)), 2).summary();
    assert_eq!(found.subset, 2);
    assert!(found.bound_ratio.iter().all(|ratio| ratio.is_some_and(|ratio| ratio > 1.0)), "{found:?}");
    let run = PlantRun::new(&family(), 1, 0, 6);
    let last = |gains| breaths(&run, &rivals::pid(gains).unwrap()).unwrap()[1].score;
    assert!(last(rivals::own_pid(&run).unwrap()) <= last(SOUND));
}

#[test]
fn plants_take_turns_at_the_papers_waveforms_and_have_noise_of_their_own() {
    let runs: Vec<_> = (0..7).map(|number| PlantRun::new(&family(), 1, number, 1)).collect();
    let pips: Vec<_> = runs.iter().map(|run| run.settings.pip).collect();
    assert_eq!(pips, [10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 10.0]);
    assert_ne!(runs[0].noise, runs[6].noise);
}
