//! The bound is reached, close to known optima, and scored like an evaluation.

use std::sync::atomic::AtomicBool;

use shared::breath::{DEFAULT_PERIOD_US, Phase, paper_settings};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use super::bench_breath::BenchBreath;
use super::descent::Descent;
use super::shape::CommandShape;
use super::*;
use crate::evaluate::{at_pips, evaluate, trace};
use plant::bench::{BenchError, LeakChange, SensorConfig, ValveConfig};
use ventilator::BenchSource;

/// Gains near the best ones at R 20, C 20.
const GOOD: PidGains = PidGains { p: 7.2, i: 253.0, d: 0.133 };

fn quiet(bench: BenchConfig) -> BenchConfig {
    let sensor = SensorConfig { noise_sd_cmh2o: 0.0, quantum_cmh2o: 0.0, ..bench.sensor };
    BenchConfig { sensor, ..bench }
}

fn pid(gains: PidGains) -> Controller {
    Controller::Pid(Pid::new(gains, DEFAULT_PERIOD_US).unwrap())
}

fn plan(pips: &[f32]) -> Plan {
    Plan {
        waveforms: at_pips(pips, &Settings::default()),
        breaths: 1,
        warm_up: 8,
        seeds: vec![1],
        ..Plan::default()
    }
}

fn bound(
    bench: &BenchConfig,
    plan: &Plan,
    search: &BoundConfig,
    progress: &Progress<'_>,
) -> Result<Bound, BoundError> {
    Ok(bounds(std::slice::from_ref(bench), plan, search, progress)?.remove(0))
}

fn found(bench: &BenchConfig, pips: &[f32], search: &BoundConfig) -> Bound {
    bound(bench, &plan(pips), search, &Progress::silent()).unwrap()
}

#[test]
fn a_sequence_is_scored_as_an_evaluation_scores_it() {
    // This lung does not empty in an expiration, so earlier breaths matter.
    let bench = quiet(BenchConfig::paper(50.0, 50.0));
    let gains = PidGains { p: 2.0, i: 30.0, d: 0.0 };
    let settings = paper_settings(25.0);
    let evaluated = evaluate(&bench, &pid(gains), &plan(&[25.0])).unwrap().mean;
    let breaths = trace(&bench, &pid(gains), &settings, DEFAULT_PERIOD_US, 1, 9).unwrap();
    let last = breaths.u_in.len() - 3000;
    let commands: Vec<f32> = breaths.u_in[last..last + 1000].iter().map(|u| *u as f32).collect();
    let breath = BenchBreath::new(&bench, &settings, DEFAULT_PERIOD_US, 0).unwrap();
    let scored = breath.score(&breath.inspire(&breath.periodic(&commands), &commands));
    assert!((scored.score - evaluated.score).abs() < 1e-3, "{scored:?} {evaluated:?}");
    let from_rest = breath.score(&breath.inspire(&breath.periodic(&[]), &commands));
    assert!((from_rest.score - evaluated.score).abs() > 5e-3, "{from_rest:?}");
}

#[test]
fn no_pid_beats_the_bound() {
    let bench = quiet(BenchConfig::paper(20.0, 20.0));
    let bound = found(&bench, &[10.0], &BoundConfig::default());
    for gains in [GOOD, PidGains { p: 4.5, i: 97.0, d: 0.0 }, PidGains { p: 3.0, i: 30.0, d: 0.0 }] {
        let rival = evaluate(&bench, &pid(gains), &plan(&[10.0])).unwrap();
        for (bound, rival) in bound.waveforms.iter().zip(&rival.waveforms) {
            assert!(bound.score.score < 0.95 * rival.score.score, "{bound:?} {rival:?}");
        }
    }
}

#[test]
fn twice_the_search_finds_less_than_a_hundredth_more() {
    let bench = BenchConfig::paper(5.0, 20.0);
    let once = found(&bench, &[15.0], &BoundConfig::default()).mean.score;
    let twice = found(&bench, &[15.0], &BoundConfig { effort: 2, ..BoundConfig::default() }).mean.score;
    assert!(twice <= once && twice > 0.99 * once, "{once} {twice}");
}

#[test]
fn no_commands_beat_the_dead_time() {
    let of = |dead_time_ms: f64| {
        let valve = ValveConfig { dead_time_ms, ..ValveConfig::default() };
        let bench = BenchConfig { valve, ..BenchConfig::paper(20.0, 20.0) };
        found(&bench, &[25.0], &BoundConfig::default()).mean.score
    };
    // In the additional dead time the error is the step from PEEP to PIP, minus the effect of the bias flow; the rise
    // is then a little faster, because the expiratory valve has closed further.
    let later = (of(32.0) - of(12.0)) / (0.020 * 20.0);
    assert!((0.85..1.0).contains(&later), "{later}");
}

#[test]
fn where_the_valve_is_too_small_full_flow_is_the_best() {
    let valve = ValveConfig { max_flow_l_per_s: 0.4, ..ValveConfig::default() };
    let bench = BenchConfig { valve, ..BenchConfig::paper(5.0, 50.0) };
    let settings = paper_settings(35.0);
    let breath = BenchBreath::new(&bench, &settings, DEFAULT_PERIOD_US, 0).unwrap();
    let full = vec![100.0; breath.ticks()];
    let full = breath.score(&breath.inspire(&breath.periodic(&full), &full)).score;
    let bound = found(&bench, &[35.0], &BoundConfig::default()).mean.score;
    assert!((bound / full - 1.0).abs() < 1e-3, "{bound} {full}");
}

#[test]
fn a_command_that_may_change_less_often_bounds_higher() {
    let bench = BenchConfig::paper(20.0, 20.0);
    let of = |period_us| {
        let plan = Plan { period_us, ..plan(&[20.0]) };
        let search = BoundConfig { trace: true, ..BoundConfig::default() };
        bound(&bench, &plan, &search, &Progress::silent()).unwrap().waveforms.remove(0)
    };
    let (fine, coarse) = (of(1000), of(20_000));
    assert_eq!(coarse.trace.map(|trace| trace.u_in.len()), Some(50));
    assert!(coarse.score.score > fine.score.score, "{:?} {:?}", coarse.score, fine.score);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let bench = BenchConfig::paper(50.0, 10.0);
    let plan = Plan { period_us: 10_000, ..plan(&[10.0, 20.0, 30.0]) };
    let search = BoundConfig { trace: true, ..BoundConfig::default() };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bound(&bench, &plan, &search, &Progress::silent()).unwrap())
    };
    assert!(on(1) == on(3), "one thread and three find different sequences");
}

#[test]
fn a_search_that_is_stopped_claims_nothing() {
    let stop = AtomicBool::new(true);
    let bench = BenchConfig::paper(20.0, 20.0);
    let (plan, search) = (plan(&[10.0, 20.0]), BoundConfig::default());
    let bound = bound(&bench, &plan, &search, &Progress::quiet(&stop)).unwrap();
    assert!(!bound.complete && bound.waveforms.is_empty(), "{bound:?}");
}

#[test]
fn a_patient_who_moves_is_refused() {
    for patient in [
        PatientConfig {
            effort_cmh2o: 5.0,
            effort_variability_percent: 5.0,
            effort_rate_per_min: 20.0,
            ..PatientConfig::default()
        },
        PatientConfig {
            effort_cmh2o: 5.0,
            double_efforts_percent: 5.0,
            effort_rate_per_min: 20.0,
            ..PatientConfig::default()
        },
        PatientConfig {
            effort_cmh2o: 5.0,
            effort_wanes_percent: 5.0,
            effort_rate_per_min: 20.0,
            ..PatientConfig::default()
        },
        PatientConfig { cough_cmh2o: 5.0, ..PatientConfig::default() },
        PatientConfig { change_at_breath: 3, ..PatientConfig::default() },
        PatientConfig { resistance_growth_percent_per_hour: 5.0, ..PatientConfig::default() },
    ] {
        let bench = BenchConfig { patient, ..BenchConfig::paper(20.0, 20.0) };
        let refused = bound(&bench, &plan(&[20.0]), &BoundConfig::default(), &Progress::silent());
        assert!(matches!(refused, Err(BoundError::Patient(_))));
    }
}

#[test]
fn efforts_that_drift_against_the_breaths_are_refused() {
    let patient =
        PatientConfig { effort_cmh2o: 5.0, effort_rate_per_min: 20.001, ..PatientConfig::default() };
    let bench = BenchConfig { patient, ..BenchConfig::paper(20.0, 20.0) };
    let refused = bound(&bench, &plan(&[20.0]), &BoundConfig::default(), &Progress::silent()).unwrap_err();
    assert!(refused.to_string().contains("effort_rate_per_min to 20,"), "{refused}");
}

#[test]
fn no_pid_beats_the_bound_of_the_same_breath_from_rest_under_prescriptions_of_all_kinds() {
    // A lung that keeps most of its gas, a ramp, a short and a long inspiration, and no PEEP.
    let base = Settings { peep: 17.0, pip: 39.0, rise_time: 0.1, ..Settings::default() };
    for (lung, settings) in [
        ((40.0, 30.0), Settings { rate: 41.0, fall_time: 0.1, expiratory_bias: 13.0, ..base }),
        (
            (20.0, 20.0),
            Settings { peep: 0.0, pip: 15.0, inspiratory_time: 0.4, rise_time: 0.0, rate: 30.0, ..base },
        ),
        ((10.0, 20.0), Settings { peep: 5.0, pip: 20.0, inspiratory_time: 1.6, rate: 15.0, ..base }),
    ] {
        let bench = quiet(BenchConfig::paper(lung.0, lung.1));
        for number in [1, 4] {
            let plan = Plan {
                waveforms: vec![settings],
                breaths: 1,
                warm_up: number as usize - 1,
                seeds: vec![1],
                goes_on: true,
                ..Plan::default()
            };
            let search = BoundConfig { breath: Some(number), ..BoundConfig::default() };
            let bound = bound(&bench, &plan, &search, &Progress::silent()).unwrap().mean.score;
            let rival = |gains| evaluate(&bench, &pid(gains), &plan).unwrap().mean.score;
            let best = [GOOD, PidGains { p: 4.5, i: 97.0, d: 0.0 }, PidGains { p: 8.0, i: 260.0, d: 0.18 }]
                .into_iter()
                .map(rival)
                .fold(f64::INFINITY, f64::min);
            assert!(bound > 0.0 && bound < best, "{lung:?} breath {number}: {bound} {best}");
        }
    }
}

/// This patient breathes slightly faster than the set rate and so triggers every breath but the first two. The bench of the
/// search is then in the state of the ventilator's.
#[test]
fn a_triggered_sequence_is_scored_as_on_the_ventilator() {
    let settings = Settings { rate: 19.0, ..paper_settings(20.0) };
    let slower = Settings { rate: 18.0, ..settings };
    let bench =
        triggering(&quiet(BenchConfig::paper(20.0, 20.0)), 6.0, &settings, DEFAULT_PERIOD_US).unwrap();
    let controller = pid(PidGains { p: 2.0, i: 30.0, d: 0.0 });
    let mut source = BenchSource::new(&bench, controller, &slower, DEFAULT_PERIOD_US, 1).unwrap();
    let (mut ticks, mut delay, mut commands, mut pressure) = (0, 0, Vec::new(), Vec::new());
    let length = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap().total_ticks();
    for breath in 0..9 {
        assert_eq!(source.triggered(), breath > 1, "breath {breath}");
        (delay, commands, pressure) = (ticks % length, Vec::new(), Vec::new());
        source
            .breathe(&slower, &mut |tick| {
                ticks += 1;
                if tick.sample.phase == Phase::Inspiration {
                    commands.push(tick.sample.u_in);
                    pressure.push(f64::from(tick.truth.unwrap().airway_pressure));
                }
            })
            .unwrap();
    }
    assert!((10..=60).contains(&delay), "{delay} ms");
    let breath = BenchBreath::new(&bench, &settings, DEFAULT_PERIOD_US, delay).unwrap();
    let found = breath.score(&breath.inspire(&breath.periodic(&commands), &commands)).score;
    let ventilated = breath.score(&pressure).score;
    assert!((found / ventilated - 1.0).abs() < 0.01, "{found} {ventilated}");
    let untimely = BenchBreath::new(&bench, &settings, DEFAULT_PERIOD_US, delay + 300).unwrap();
    let other = untimely.score(&untimely.inspire(&untimely.periodic(&commands), &commands)).score;
    assert!((other / ventilated - 1.0).abs() > 0.05, "{other} {ventilated}");
}

/// With the expiratory valve closed, the gas that a strong effort has drawn in stays when the muscles relax.
#[test]
fn no_commands_make_up_for_a_strong_effort_at_a_low_pip() {
    let bench = BenchConfig::paper(20.0, 20.0);
    let patient = triggering(&bench, 10.0, &paper_settings(10.0), DEFAULT_PERIOD_US).unwrap();
    let of = |bench: &BenchConfig| found(bench, &[10.0], &BoundConfig::default()).mean.score;
    let (passive, triggered) = (of(&bench), of(&patient));
    assert!(triggered > 5.0 * passive, "{passive} {triggered}");
}

#[test]
fn a_leak_that_changes_is_refused() {
    let mut bench = BenchConfig::paper(20.0, 20.0);
    bench.circuit.leak_changes = vec![LeakChange { at_s: 60.0, leak_l_per_s_at_30_cmh2o: 0.3 }];
    let refused = bound(&bench, &plan(&[20.0]), &BoundConfig::default(), &Progress::silent());
    assert!(matches!(refused, Err(BoundError::Patient(_))));
}

#[test]
fn a_period_that_the_bench_cannot_run_is_refused() {
    let plan = Plan { period_us: 1500, ..plan(&[20.0]) };
    let refused = bound(&BenchConfig::paper(20.0, 20.0), &plan, &BoundConfig::default(), &Progress::silent());
    assert!(matches!(
        refused,
        Err(BoundError::Source(SourceError::Bench(BenchError::Period { period_us: 1500 })))
    ));
}

#[test]
fn a_step_never_climbs_and_stays_within_the_valves_range() {
    let bench = BenchConfig::paper(5.0, 10.0);
    let breath = BenchBreath::new(&bench, &paper_settings(30.0), DEFAULT_PERIOD_US, 0).unwrap();
    let commands = vec![20.0; breath.ticks()];
    let shape = CommandShape::through(&commands, 25);
    let mut descent = Descent::new(&breath, breath.periodic(&commands), shape);
    let before = descent.score;
    for _ in 0..12 {
        let last = descent.score;
        let gain = descent.step();
        assert!((last - gain - descent.score).abs() < 1e-12 && gain >= 0.0);
        assert!(descent.shape.values.iter().all(|value| (0.0..=100.0).contains(value)));
    }
    assert!(descent.score < 0.3 * before, "{before} {}", descent.score);
}
