//! Triggered and timed breaths are told apart and scored like any others.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::ThreadPoolBuilder;
use shared::control::pid::{Pid, PidGains};

use super::*;
use crate::evaluate::{at_pips, evaluate};
use progress::Event;
use shared::control::Controller;

fn pid(p: f32, i: f32) -> Controller {
    Controller::Pid(Pid::new(PidGains { p, i, d: 0.0 }, 1000).unwrap())
}

/// Two waveforms under one noise sequence.
fn small() -> Plan {
    Plan {
        waveforms: at_pips(&[15.0, 30.0], &Settings::default()),
        breaths: 4,
        seeds: vec![1],
        ..Plan::default()
    }
}

fn scored(benches: &[BenchConfig], controllers: &[&Controller]) -> BreathingScores {
    breathing(benches, controllers, &small(), &Progress::silent()).unwrap()
}

#[test]
fn every_breath_is_timed_or_triggered_and_without_efforts_all_are_timed() {
    let (lung, good) = (BenchConfig::paper(20.0, 20.0), pid(3.0, 60.0));
    let scored = scored(std::slice::from_ref(&lung), &[&good]);
    assert_eq!(scored.patients.len(), STRENGTHS.len());
    for (patients, strength) in scored.patients.iter().zip(STRENGTHS) {
        assert_eq!((patients.lung.as_str(), patients.effort_cmh2o.to_bits()), ("R20C20", strength.to_bits()));
        assert_eq!(patients.timed_breaths + patients.triggered_breaths, 2 * 4 * RHYTHMS.len());
        assert!(patients.timed_breaths >= 4 && patients.triggered_breaths >= 8, "{patients:?}");
    }
    let passive = evaluate(&lung, &good, &small()).unwrap().mean.score;
    for patients in &scored.patients {
        assert!((patients.controllers[0].passive.unwrap() - passive).abs() < 1e-9);
    }
}

#[test]
fn a_strong_effort_disturbs_triggered_breaths_more_than_a_weak_one() {
    let scored = scored(&[BenchConfig::paper(20.0, 20.0)], &[&pid(3.0, 60.0)]);
    let of = |n: usize| scored.patients[n].controllers[0];
    let (weak, strong) = (of(0), of(2));
    assert!(strong.triggered.unwrap() > 1.2 * weak.triggered.unwrap(), "{weak:?} {strong:?}");
    assert!(strong.triggered_to_timed().unwrap() > 1.1 && strong.triggered_to_passive().unwrap() > 1.2);
    let mean = scored.patients.iter().map(|p| p.controllers[0].triggered.unwrap()).sum::<f64>() / 3.0;
    assert!((scored.mean[0].triggered.unwrap() - mean).abs() < 1e-12);
}

#[test]
fn controllers_keep_their_order_and_meet_the_same_patients() {
    let (good, weak) = (pid(3.0, 60.0), pid(0.5, 5.0));
    let both = scored(&[BenchConfig::paper(20.0, 20.0)], &[&weak, &good]);
    assert!(both.mean[0].passive.unwrap() > both.mean[1].passive.unwrap());
    let alone = scored(&[BenchConfig::paper(20.0, 20.0)], &[&good]);
    assert_eq!(alone.mean[0], both.mean[1]);
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let with = |threads| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| scored(&[BenchConfig::paper(50.0, 20.0)], &[&pid(3.0, 60.0)]))
    };
    assert_eq!(with(1), with(2));
}

#[test]
fn a_kind_that_a_waveform_lacks_has_no_score() {
    let sums = |breaths| [Sum { breaths: 2, score: 3.0 }, Sum { breaths, score: 4.0 }];
    assert_eq!(score(&[sums(1), sums(0)], 1), None);
    assert_eq!(score(&[sums(1), sums(2)], 1), Some(3.0));
    assert_eq!(score(&[sums(1), sums(0)], 0), Some(1.5));
    let unknown = Kinds { timed: Some(2.0), ..Kinds::default() };
    assert_eq!((unknown.triggered_to_timed(), unknown.triggered_to_passive()), (None, None));
    assert_eq!(Kinds::mean(&[]), Kinds::default());
}

#[test]
fn a_stopped_evaluation_keeps_the_lungs_that_are_done() {
    let (plan, good, stop) = (small(), pid(3.0, 60.0), AtomicBool::new(false));
    let lungs = [BenchConfig::paper(20.0, 20.0), BenchConfig::paper(50.0, 20.0)];
    let runs = 2 * (1 + STRENGTHS.len() * RHYTHMS.len());
    let after_the_first = |event: &Event<'_>| {
        assert_eq!(event.total, 2 * runs);
        stop.fetch_or(event.done >= runs, Ordering::Relaxed);
    };
    let half = breathing(&lungs, &[&good], &plan, &Progress::new(&after_the_first, &stop)).unwrap();
    assert_eq!(half.patients.iter().map(|p| p.lung.as_str()).collect::<Vec<_>>(), ["R20C20"; 3]);
}

#[test]
fn refused_settings_are_an_error() {
    let plan = Plan { waveforms: at_pips(&[500.0], &Settings::default()), ..small() };
    let refused = breathing(&[BenchConfig::default()], &[&pid(3.0, 60.0)], &plan, &Progress::silent());
    assert!(matches!(refused, Err(SourceError::Settings(_))));
}

#[test]
fn a_patient_can_breathe_at_every_rate_that_can_be_set() {
    let rate = field("rate");
    for (rhythm, rate) in RHYTHMS.iter().flat_map(|rhythm| [rate.min, rate.max].map(|rate| (*rhythm, rate))) {
        let patient = patient(STRENGTHS[0], rhythm, &Settings { rate, ..Settings::default() });
        let bench = BenchConfig { patient, ..BenchConfig::default() };
        assert!(bench.validate().is_ok(), "{rhythm:?} at {rate}: {:?}", bench.validate());
    }
}
