//! Tests of the lung estimator.

use super::*;
use std::vec::Vec;

const PERIOD_US: u32 = 1000;

fn estimator() -> (LungEstimator, LungState) {
    (LungEstimator::new(PERIOD_US), LungState::default())
}

/// A valve that has been at an opening for long, percent.
fn open_at(opening: f32) -> LungState {
    LungState { opening, valve_flow: flow(opening), ..LungState::default() }
}

#[test]
fn a_sound_flow_sensor_counts_the_gas_without_a_pressure_but_never_too_little() {
    let delivered = |measured: Option<f32>| {
        let (estimator, mut state) = estimator();
        for _ in 0..500 {
            estimator.applied(&mut state, 50.0);
        }
        estimator.deliver(&mut state, None);
        state.volume = 100.0;
        estimator.deliver(&mut state, measured);
        (state.volume - 100.0, state.flow)
    };
    let (model, flow) = delivered(None);
    assert!((0.6..0.64).contains(&flow) && (model - flow).abs() < 1e-4, "{model} mL in 1 ms");
    for (measured, counts) in [(0.9, 0.9), (0.5, 0.5), (0.1, 0.6 * flow)] {
        let (volume, counted) = delivered(Some(measured));
        assert!(
            (volume - counts).abs() < 1e-3 && (counted - counts).abs() < 1e-3,
            "{measured} L/s: {volume} mL"
        );
    }
}

#[test]
fn the_command_for_a_flow_delivers_it() {
    for percent in 0..=1000 {
        let command = percent as f32 * 0.1;
        assert!((command_for(flow(command)) - command).abs() < 1e-2, "{command} %");
    }
    assert!(command_for(-1.0).abs() < 1e-6 && (command_for(9.0) - 100.0).abs() < 1e-6);
}

/// An inspiration with a constant command into a lung; returns the ticks at which no response was reported.
fn inspire(state: &mut LungState, command: f32, pressure: impl Fn(&LungState) -> f32) -> Vec<usize> {
    let (estimator, _) = estimator();
    state.start_inspiration(5.0, 5.0);
    let silent = (0..1000).filter(|_| {
        let silent = estimator.check(state, pressure(state), false);
        estimator.applied(state, command);
        silent
    });
    let silent = silent.collect();
    estimator.end_inspiration(state, false);
    silent
}

fn lung(elastance: f32, resistance: f32) -> impl Fn(&LungState) -> f32 {
    move |state| 5.0 + elastance * state.volume + resistance * state.flow
}

#[test]
fn the_last_estimate_is_that_of_the_newest_inspiration() {
    let (_, mut state) = estimator();
    assert_eq!(state.last_estimate(), None);
    for (elastance, resistance) in [(0.05, 20.0), (0.1, 5.0)] {
        inspire(&mut state, 30.0, lung(elastance, resistance));
        let found = state.last_estimate().unwrap();
        assert!((found.elastance - elastance).abs() < 0.01 * elastance, "{found:?}");
        assert!((found.resistance - resistance).abs() < 0.5, "{found:?}");
    }
}

#[test]
fn the_lung_is_found_from_one_inspiration() {
    for (compliance, resistance) in [(10.0, 5.0), (50.0, 50.0), (20.0, 20.0)] {
        let mut state = LungState::default();
        inspire(&mut state, 30.0, lung(1.0 / compliance, resistance));
        let found = state.lungs[0].unwrap();
        let e = found.elastance;
        assert!((e * compliance - 1.0).abs() < 0.05, "C {compliance}: {}", 1.0 / e);
        assert!((found.resistance - resistance).abs() < 2.0, "R {resistance}: {}", found.resistance);
    }
}

#[test]
fn a_sound_lung_answers_and_a_silent_one_is_found_long_before_it_bursts() {
    let mut state = LungState::default();
    let stiff = || lung(0.1, 5.0);
    assert!(inspire(&mut state, 40.0, stiff()).is_empty());
    assert!(inspire(&mut state, 40.0, stiff()).is_empty());
    let silent = inspire(&mut state, 100.0, |_| 5.3);
    assert!(silent[0] < 150, "found at {} ms", silent[0]);
}

#[test]
fn before_the_lung_is_known_the_softest_one_is_assumed() {
    let silent = inspire(&mut LungState::default(), 100.0, |_| 5.0);
    assert!((700..950).contains(&silent[0]), "found at {} ms", silent[0]);
}

#[test]
fn a_lung_that_becomes_twice_as_soft_still_answers() {
    let mut state = LungState::default();
    inspire(&mut state, 40.0, lung(0.05, 20.0));
    assert!(inspire(&mut state, 40.0, lung(0.025, 20.0)).is_empty());
    assert!(inspire(&mut state, 40.0, lung(0.025, 5.0)).is_empty());
}

#[test]
fn commands_take_effect_after_the_dead_time_and_then_with_the_lag() {
    let (estimator, mut state) = estimator();
    let opened = (0..100).position(|_| {
        estimator.applied(&mut state, 80.0);
        estimator.check(&mut state, 5.0, false);
        state.flow > 0.0
    });
    assert_eq!(opened, Some(12));
    for _ in 0..24 {
        estimator.applied(&mut state, 80.0);
    }
    let left = (25.0_f32 / 26.0).powi(25);
    assert!((state.opening - 80.0 * (1.0 - left)).abs() < 0.01, "{} % after a lag of 25 ms", state.opening);
    // The ring of commands comes round several times.
    for n in 0..200 {
        estimator.applied(&mut state, if n < 180 { 0.0 } else { 100.0 });
    }
    assert!((15.0..40.0).contains(&state.opening), "{} % after 8 ms", state.opening);
}

#[test]
fn the_valves_flow_is_its_curve_and_never_beyond_it() {
    let curve =
        [(-5.0, 0.0), (0.0, 0.0), (5.0, 0.023), (10.0, 0.046), (75.0, 1.1295), (95.0, 1.5595), (100.0, 1.67)];
    for (opening, expected) in curve.into_iter().chain([(130.0, 1.67), (f32::NAN, 0.0)]) {
        let open = open_at(opening);
        assert!((open.valve_flow() - expected).abs() < 1e-5, "{opening} %: {}", open.valve_flow());
    }
}

#[test]
fn a_pressure_behind_the_valve_takes_flow_away_and_flow_sums_to_volume() {
    let open = |pressure: f32| {
        let (estimator, _) = estimator();
        let mut state = open_at(100.0);
        estimator.check(&mut state, pressure, false);
        estimator.check(&mut state, pressure, false);
        (state.flow, state.volume())
    };
    for (pressure, flow) in [(0.0, 1.67), (100.0, 0.67 * 1.67), (400.0, 0.0)] {
        let (found, volume) = open(pressure);
        assert!((found - flow).abs() < 1e-5 && (volume - 2.0 * flow).abs() < 1e-5, "{pressure} cmH2O");
    }
}

#[test]
fn without_a_reading_the_predicted_pressure_takes_flow_away() {
    let (estimator, _) = estimator();
    let mut state = LungState { start: 40.0, valve_flow: flow(100.0), ..predicting(60.0) };
    estimator.deliver(&mut state, None);
    assert!((state.flow - 0.67 * 1.67).abs() < 1e-5, "{} L/s against 100 cmH2O", state.flow);
}

/// Ticks of an inspiration: volume, flow, and the rise that these make of it.
fn sums(ticks: &[(f32, f32)], rise: impl Fn(f32, f32) -> [f32; 2]) -> LungFit {
    let mut sums = LungFit::default();
    for (volume, flow) in ticks {
        // Each twice, so that what is added once and taken away once is in no way explained.
        for y in rise(*volume, *flow) {
            sums.add(*volume, *flow, y);
        }
    }
    sums
}

const TICKS: [(f32, f32); 3] = [(100.0, 0.5), (200.0, 0.3), (350.0, 0.1)];

#[test]
fn elastance_and_resistance_are_those_of_the_least_squares_within_their_bounds() {
    for (elastance, resistance, bounded) in [
        (0.05, 20.0, (0.05, 20.0)),
        (0.3, 5.0, (0.3, 5.0)),
        (2.0, 10.0, (1.0, 10.0)),
        (0.002, 30.0, (SOFTEST, 30.0)),
        (0.1, 300.0, (0.1, 100.0)),
        (0.1, -20.0, (0.1, 0.0)),
    ] {
        let lung = sums(&TICKS, |v, q| [elastance * v + resistance * q; 2]).solve().unwrap();
        assert!((lung.elastance - bounded.0).abs() < 1e-4, "E {elastance}: {}", lung.elastance);
        assert!((lung.resistance - bounded.1).abs() < 0.05, "R {resistance}: {}", lung.resistance);
    }
    assert_eq!(sums(&TICKS, |_, _| [0.0; 2]).solve(), Some(LungEstimate::SOFTEST), "no rise at all");
}

#[test]
fn what_does_not_behave_like_a_lung_tells_nothing() {
    let with_unexplained = |part: f32| {
        let rise = |v: f32, q: f32| 0.05 * v + 20.0 * q;
        sums(&TICKS, |v, q| [rise(v, q) * (1.0 + part), rise(v, q) * (1.0 - part)]).solve()
    };
    // part^2 / (1 + part^2) of the square.
    assert!(with_unexplained(0.3).is_some() && with_unexplained(0.37).is_none());
    let in_step = |last_flow| {
        sums(&[(100.0, 0.5), (200.0, 1.0), (300.0, last_flow)], |v, q| [0.05 * v + 20.0 * q; 2]).solve()
    };
    assert!(in_step(1.57).is_none() && in_step(1.62).is_some(), "volume and flow cannot be told apart");
}

/// A closed valve that has delivered what makes this rise, cmH2O.
fn predicting(rise: f32) -> LungState {
    let lung = LungEstimate { elastance: 1.0, resistance: 0.0 };
    LungState { volume: rise, lungs: [Some(lung), None, None, None, None], ..LungState::default() }
}

/// At which of 200 ticks a rise was first called silent, while the predicted one grows by so much in a tick.
fn silent(state: LungState, growth: f32, rise: impl Fn(usize) -> f32) -> Option<usize> {
    let ((estimator, _), mut state) = (estimator(), state);
    (0..200).position(|tick| {
        let silent = estimator.check(&mut state, rise(tick), false);
        state.volume += growth;
        silent
    })
}

#[test]
fn an_eighth_of_a_telling_rise_must_be_seen_within_forty_milliseconds() {
    let constant = |predicted, rise| silent(predicting(predicted), 0.0, |_| rise);
    assert_eq!(constant(20.0, 0.119 * 20.0), Some(39));
    assert_eq!((constant(20.0, ANSWER * 20.0), constant(20.0, 3.0)), (None, None), "it answers");
    assert_eq!((constant(10.0, 1.0), constant(10.1, 1.0)), (None, Some(39)), "a rise that tells");
    assert_eq!((constant(20.0, -1.5), constant(20.0, -1.4)), (None, Some(39)), "an open tube");
    let interrupted = silent(predicting(20.0), 0.0, |tick| if tick % 39 == 38 { 3.0 } else { 1.0 });
    assert_eq!(interrupted, None);
}

#[test]
fn a_pressure_may_stand_still_for_twenty_milliseconds_against_a_telling_rise() {
    let constant = |predicted, rise| silent(predicting(predicted), 0.0, |_| rise);
    assert_eq!((constant(20.0, 0.59), constant(20.0, -0.59)), (Some(19), Some(19)));
    assert_eq!(constant(20.0, STANDS), Some(39), "a change, if too small an answer");
    assert_eq!((constant(10.0, 0.5), constant(10.1, 0.5)), (None, Some(19)));
    // Far above the start, and growing by 32 cmH2O in a window of 64 ms.
    assert_eq!(silent(predicting(100.0), 0.5, |_| 30.0), Some(64 + 19));
    assert_eq!(silent(predicting(100.0), 10.0 / 64.0, |_| 30.0), None, "by 10 cmH2O");
    let between = |tick: usize| if tick % 64 < 32 { 30.0 } else { 35.0 };
    assert_eq!(silent(predicting(100.0), 0.5, between), None, "where it was, but not all the time");
    // Below the start and still: an open tube, which the breath monitor finds.
    let gone = LungState { start: 40.0, ..predicting(100.0) };
    assert_eq!(silent(gone.clone(), 0.5, |_| 38.5), None);
    assert_eq!(silent(LungState { start: 39.9, ..gone }, 0.5, |_| 38.5), Some(39), "hardly below");
}

/// The newest estimates, and that of a timed breath.
const ALL: usize = ESTIMATES + 1;

/// The state after 100 mL, at 0.5 L/s, with the estimates of these elastances and resistances.
fn estimated(lungs: [Option<(f32, f32)>; ALL]) -> LungState {
    let lungs = lungs.map(|lung| lung.map(|(elastance, resistance)| LungEstimate { elastance, resistance }));
    LungState { volume: 100.0, flow: 0.5, lungs, ..LungState::default() }
}

const SOFT: Option<(f32, f32)> = Some((0.05, 10.0));
const STIFF: Option<(f32, f32)> = Some((0.2, 4.0));

#[test]
fn of_all_lungs_the_one_that_rises_least_is_believed() {
    let rise = |lungs| estimated(lungs).predicted_rise();
    for place in 0..ALL {
        let mut lungs = [STIFF; ALL];
        lungs[place] = SOFT;
        assert!((rise(lungs) - 10.0).abs() < 1e-4);
        let mut only = [None; ALL];
        only[place] = STIFF;
        assert!((rise(only) - 22.0).abs() < 1e-4);
    }
    assert!((rise([None; ALL]) - 100.0 / 120.0).abs() < 1e-4);
}

#[test]
fn the_highest_pressure_is_that_of_the_newest_two_lungs() {
    let highest = |lungs| estimated(lungs).predicted_pressure();
    for lungs in [[SOFT, STIFF, None, None, None], [STIFF, SOFT, SOFT, SOFT, SOFT]] {
        assert!((highest(lungs).unwrap() - 22.0).abs() < 1e-4);
    }
    assert!((highest([SOFT, SOFT, STIFF, STIFF, STIFF]).unwrap() - 10.0).abs() < 1e-4);
    assert_eq!(highest([None; ALL]), None);
}

#[test]
fn an_inspiration_starts_from_peep_at_most_and_knows_nothing_of_the_last() {
    let (estimator, mut state) = estimator();
    inspire(&mut state, 40.0, lung(0.1, 5.0));
    let lungs = state.lungs;
    state.start_inspiration(20.0, 5.0);
    assert_eq!(
        (state.start as i32, state.volume() as i32, state.sums, state.lungs),
        (5, 0, LungFit::default(), lungs)
    );
    state.start_inspiration(3.0, 5.0);
    assert_eq!(state.start as i32, 3);
    let mut late = LungState { unanswered: 39, standing: 19, ..predicting(20.0) };
    late.start_inspiration(5.0, 5.0);
    late.volume = 20.0;
    assert!(!estimator.check(&mut late, 5.0, false));
}

#[test]
fn an_inspiration_of_a_few_ticks_has_filled_the_tube_alone_and_tells_nothing() {
    let told = sums(&TICKS, |v, q| [0.05 * v + 20.0 * q; 2]);
    let mut state = LungState { volume: 100.0, sums: told, ticks: 149, ..predicting(0.0) };
    let before = state.lungs;
    estimator().0.end_inspiration(&mut state, false);
    assert_eq!(state.lungs, before);
}

#[test]
fn an_inspiration_of_twenty_millilitres_tells_of_the_lung_and_a_smaller_one_does_not() {
    let after = |volume| {
        let told = sums(&TICKS, |v, q| [0.05 * v + 20.0 * q; 2]);
        let mut state = LungState { volume, sums: told, ticks: 150, ..predicting(0.0) };
        estimator().0.end_inspiration(&mut state, false);
        state.lungs.map(|lung| lung.map(|lung| (100.0 * lung.elastance + 0.5) as i32))
    };
    assert_eq!(after(TELLING_VOLUME), [Some(5), Some(100), None, None, Some(5)], "the newest first");
    assert_eq!(after(TELLING_VOLUME - 0.1), [Some(100), None, None, None, None]);
}

#[test]
fn the_last_estimate_of_a_timed_breath_outlasts_all_of_those_that_efforts_have_started() {
    let (estimator, mut state) = estimator();
    let mut rise_after = |elastance: f32, triggered: bool| {
        let told = sums(&TICKS, |v, q| [elastance * v + 20.0 * q; 2]);
        state = LungState { volume: 100.0, flow: 0.0, sums: told, ticks: 150, ..state.clone() };
        estimator.end_inspiration(&mut state, triggered);
        (state.predicted_rise() + 0.5) as i32
    };
    assert_eq!(rise_after(0.02, false), 2);
    assert!((0..9).all(|_| rise_after(0.08, true) == 2));
    assert_eq!([(); 3].map(|()| rise_after(0.04, false)), [4; 3]);
}

#[test]
fn a_lung_is_known_from_its_second_estimate_on() {
    let known = |lungs| estimated(lungs).is_known();
    assert!(!known([None; ALL]) && !known([None, SOFT, None, None, SOFT]), "the last one is a copy");
    assert!(!known([SOFT, SOFT, SOFT, SOFT, None]), "efforts may have falsified all of them");
    assert!(known([SOFT, None, None, SOFT, SOFT]) && known([SOFT; ALL]));
}

#[test]
fn an_inspiration_that_begins_with_trapped_gas_tells_nothing() {
    let after = |start: f32| {
        let mut state = predicting(0.0);
        state.start_inspiration(start, 5.0);
        let told = sums(&TICKS, |v, q| [0.05 * v + 20.0 * q; 2]);
        state = LungState { volume: TELLING_VOLUME, sums: told, ticks: 150, ..state };
        estimator().0.end_inspiration(&mut state, false);
        state.lungs[..ESTIMATES].iter().flatten().count()
    };
    assert_eq!((after(8.0), after(8.1)), (2, 1));
}

#[test]
fn estimates_that_a_good_inspiration_belies_are_forgotten() {
    // They predict rises of 22 and 10 cmH2O.
    let left = |pressure: f32| {
        let mut state = LungState { start: 5.0, ..estimated([STIFF, SOFT, None, STIFF, STIFF]) };
        state.forget_false(pressure);
        state.lungs.map(|lung| lung.is_some())
    };
    assert_eq!(left(16.1), [true, true, false, true, true]);
    assert_eq!(left(15.9), [false, true, false, false, false]);
    assert_eq!(left(9.9), [false; ALL]);
}

#[test]
fn a_lung_that_keeps_gas_from_breath_to_breath_has_a_higher_pressure() {
    // 40 mL/cmH2O through 5 + 15 cmH2O/(L/s): a time constant of 0.8 s.
    let lung = LungEstimate { elastance: 0.025, resistance: 5.0 };
    let after = |expirations: &[f32]| {
        let mut state = LungState { lungs: [Some(lung); ESTIMATES + 1], ..LungState::default() };
        for expiration in expirations {
            state.volume = 800.0;
            state.keep_gas(*expiration);
            state.start_inspiration(5.0, 5.0);
        }
        state.predicted_pressure().unwrap()
    };
    assert!((after(&[0.6]) - 5.0).abs() < 1e-3, "what it kept before is in the estimate");
    assert!((after(&[2.0; 9]) - 5.0).abs() < 1e-2);
    // 48 % are left in each breath: 726 mL of 800, and 97 of them were kept before.
    let short = [[2.0].as_slice(), &[0.6; 30]].concat();
    assert!((after(&short) - 5.0 - 0.025 * (726.0 - 97.0)).abs() < 1.0, "{}", after(&short));
    let mut state =
        LungState { trapped_gas: Some(TrappedGas { now: 900.0, usual: 0.0 }), ..predicting(20.0) };
    let with = state.predicted_pressure().unwrap();
    state.forget_gas();
    assert!(state.predicted_pressure().unwrap() < with - 1.0, "a pressure reading tells");
}

#[test]
fn a_lung_without_an_estimate_keeps_nothing_and_none_keeps_all() {
    let mut state = LungState { volume: 800.0, ..LungState::default() };
    state.keep_gas(0.5);
    assert_eq!(state.trapped_gas, Some(TrappedGas { now: 0.0, usual: 0.0 }));
    let lung = LungEstimate { elastance: SOFTEST, resistance: RESISTANCE_MAX };
    assert!(
        (lung.left_after(0.0) - MOST_LEFT).abs() < 1e-6 && (lung.left_after(-1.0) - MOST_LEFT).abs() < 1e-6
    );
    assert!(lung.left_after(f32::NAN) > 0.9 && lung.left_after(1e9) < 1e-6);
}
