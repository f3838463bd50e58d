//! Tests of what happens in expirations that do not go as they should.

use super::*;
use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
use crate::settings::Settings;
use std::vec::Vec;

/// Starts a breath and judges the last one.
fn begin(
    expiration: &Expiration,
    state: &mut ExpirationState,
    expired_share: Option<f32>,
    kept: bool,
) -> Option<Fault> {
    expiration.start_breath(state, expired_share, true);
    expiration.judge_last(state, expired_share, if kept { Missing::Kept } else { Missing::Lost })
}

fn breath() -> Breath {
    Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap()
}

/// Runs breaths with a plateau and a pressure in the expiration by the tick since it began.
fn breaths(count: usize, plateau: f32, pressure: impl Fn(u32) -> f32) -> (Expiration, ExpirationState) {
    breaths_with(count, plateau, Some(1.0), pressure)
}

/// The same, with this share of each breath's volume coming out.
fn breaths_with(
    count: usize,
    plateau: f32,
    expired_share: Option<f32>,
    pressure: impl Fn(u32) -> f32,
) -> (Expiration, ExpirationState) {
    let (expiration, mut state) = (Expiration::new(1000, Monitors::ALL), ExpirationState::default());
    let breath = breath();
    for tick in (0..count).flat_map(|_| 0..breath.total_ticks()) {
        let since = tick.checked_sub(breath.inspiration_ticks());
        expiration.observe(&mut state, &breath.at(tick), since.map_or(plateau, &pressure), 0.0, || false);
        if tick + 1 == breath.total_ticks() {
            begin(&expiration, &mut state, expired_share, false);
        }
    }
    (expiration, state)
}

#[test]
fn a_sag_is_compensated_and_the_compensation_ends_with_it() {
    let (expiration, mut state) = breaths(1, 25.0, |_| 3.5);
    assert!((15.0..35.0).contains(&state.compensation()), "{}", state.compensation());
    let (_, bounded) = breaths(9, 25.0, |_| 0.0);
    assert!((bounded.compensation() - BOUND).abs() < 1e-3);
    let breath = breath();
    for tick in (0..15).flat_map(|_| 1500..3000) {
        expiration.observe(&mut state, &breath.at(tick), 5.0, 0.0, || false);
    }
    assert!(state.compensation().abs() < 1e-3);
}

#[test]
fn a_sag_that_only_one_of_two_sensors_shows_raises_no_flow() {
    let (expiration, mut state) = breaths(0, 25.0, |_| 0.0);
    let breath = breath();
    for tick in 1500..3000 {
        expiration.observe(&mut state, &breath.at(tick), 2.0, 0.0, || true);
    }
    assert!(state.compensation().abs() < 1e-3);
}

#[test]
fn a_leak_takes_compensation_and_gas_and_an_effort_compensation_alone() {
    let leaks = |share, pressure: f32| {
        let (expiration, mut state) = breaths_with(6, 25.0, share, |_| pressure);
        state.compensation = state.compensation.max(if pressure < 4.5 { BOUND } else { 0.0 });
        begin(&expiration, &mut state, share, false) == Some(Fault::Leak)
    };
    assert!(leaks(Some(0.7), 3.5) && leaks(Some(0.5), 5.0));
    assert!(!leaks(Some(0.9), 3.5) && !leaks(None, 3.5) && !leaks(Some(0.7), 5.0));
    let (expiration, mut state) = breaths_with(3, 25.0, Some(0.5), |_| 5.0);
    assert_eq!(begin(&expiration, &mut state, Some(0.5), false), None);
    assert_eq!(begin(&expiration, &mut state, Some(0.5), false), Some(Fault::Leak));
}

#[test]
fn a_peep_that_flow_alone_holds_is_a_finding() {
    let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
    let mut held = |compensation, share| {
        (state.compensation, state.lowest, state.sags) = (compensation, compensation, true);
        begin(&expiration, &mut state, share, false)
    };
    assert_eq!([(); 5].map(|()| held(20.1, None)), [None, None, None, None, Some(Fault::BaselineLow)]);
    assert_eq!(held(20.0, None), None);
    assert_eq!([(); 5].map(|()| held(30.0, Some(1.0))), [None, None, None, None, Some(Fault::BaselineLow)]);
}

#[test]
fn an_effort_leaves_little_compensation_behind() {
    let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
    for inhales in [true, false] {
        for (needed, kept) in [(30.0, 17.0), (17.1, 17.0), (16.9, 16.9)] {
            (state.compensation, state.lowest) = (needed, 12.0);
            expiration.triggered(&mut state, 5.0, false, inhales);
            assert!((state.compensation() - kept).abs() < 1e-4);
        }
    }
}

#[test]
fn flow_that_holds_peep_is_found_in_breaths_that_no_effort_has_started() {
    let found = |inhales: bool, flow: f32| {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        (0..5).any(|_| {
            (state.compensation, state.lowest) = (flow, 5.0);
            expiration.triggered(&mut state, 6.0, false, inhales);
            begin(&expiration, &mut state, None, false) == Some(Fault::BaselineLow)
        })
    };
    assert!(found(false, 20.1) && !found(false, 20.0) && !found(true, 30.0));
}

#[test]
fn flow_holds_no_peep_that_the_pressure_shows_before_an_effort_or_at_the_end() {
    let found = |effort: bool, pressure: f32| {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        let breath = breath();
        (0..9).any(|_| {
            for tick in breath.inspiration_ticks()..breath.total_ticks() - u32::from(effort) {
                (state.compensation, state.lowest) = (30.0, 30.0);
                expiration.observe(&mut state, &breath.at(tick), pressure, 0.0, || false);
            }
            if effort {
                expiration.triggered(&mut state, 5.0, true, true);
            }
            begin(&expiration, &mut state, None, false) == Some(Fault::BaselineLow)
        })
    };
    assert_eq!([4.4, 4.6].map(|pressure| found(false, pressure)), [true, false]);
    assert_eq!([4.4, 4.6].map(|pressure| found(true, pressure)), [true, false]);
}

/// A breath that loses the gas of a leak, L/s at 1 cmH2O.
fn lost(leak: f32) -> Loss {
    Loss { gas: 1000.0 * leak, root: 1.0, inspired: 200.0, refill: 0.0 }
}

#[test]
fn a_leak_that_earlier_breaths_have_shown_is_made_up_for_in_advance() {
    let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
    let learnt = |state: &mut ExpirationState, leak: f32, peep: f32| {
        for _ in 0..60 {
            expiration.learn_leak(state, (peep, 0.0), lost(leak));
        }
        state.compensation()
    };
    // 0.1 L/s at PEEP, a fifth more, and 0.02 L/s: the valve's flow at 30 % is 0.303 L/s, at 20 % 0.161, at 10 % 0.046.
    assert!((learnt(&mut state, 0.05, 4.0) - 18.17).abs() < 0.05, "{}", state.compensation());
    assert!((learnt(&mut state, 0.05, 16.0) - 26.95).abs() < 0.1, "{}", state.compensation());
    assert!(learnt(&mut state, 0.0074, 4.0).abs() < 1e-6, "a tight circuit");
    assert!(learnt(&mut state, 0.0076, 4.0) > 5.0);
    assert!(learnt(&mut state, -0.3, 4.0).abs() < 1e-6);
    // The largest leak of the bench at the highest PEEP: 0.82 L/s, a fifth more, and 0.02 L/s.
    let largest = 1.0 / 30.0_f32.sqrt();
    assert!((learnt(&mut state, largest, 20.0) - 69.0).abs() < 0.5, "{}", state.compensation());
    assert!((learnt(&mut state, LARGE_LEAK, 40.0) - LEAK_BOUND).abs() < 1e-6);
    assert!(learnt(&mut state, 0.05, 4.0) > 5.0 && (state.leak() - 0.05).abs() < 1e-5);
    learnt(&mut state, 0.301, 4.0);
    assert!((state.leak() - 0.05).abs() < 1e-5, "a disconnected patient");
    learnt(&mut state, OPEN_TUBE, 4.0);
    assert!((state.leak() - 0.3).abs() < 1e-5);
}

#[test]
fn flow_for_a_leak_fades_towards_an_open_tube_and_does_not_stop_at_a_size() {
    let (expiration, mut state) = (Expiration::new(1000, Monitors::ALL), ExpirationState::default());
    let mut command = |leak: f32| {
        (0..60).for_each(|_| {
            expiration.learn_leak(&mut state, (4.0, 0.0), lost(leak));
        });
        state.compensation()
    };
    let commands: Vec<_> = (0..=30).map(|n| command(0.01 * n as f32)).collect();
    assert!(commands.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 10.0), "{commands:?}");
    assert!(commands[..=20].is_sorted() && commands[20..].is_sorted_by(|a, b| a > b));
    assert!(commands[20] > 40.0 && commands[30].abs() < 1e-3);
}

#[test]
fn a_sag_on_top_of_a_known_leak_adds_no_flow_beyond_its_own_bound() {
    let mut state = ExpirationState { advance: 30.0, compensation: 35.0, ..Default::default() };
    assert!((state.compensation() - BOUND).abs() < 1e-6);
    state.advance = 60.0;
    assert!((state.compensation() - 60.0).abs() < 1e-6);
}

#[test]
fn the_flow_of_the_bias_is_a_part_of_what_makes_up_for_a_leak() {
    let expiration = Expiration::new(1000, Monitors::ALL);
    let beyond = |bias: f32, leak: f32| {
        let mut state = ExpirationState::default();
        expiration.learn_leak(&mut state, (4.0, bias), lost(leak));
        state.compensation()
    };
    assert!((beyond(0.0, 0.05) - beyond(5.0, 0.05) - 5.0).abs() < 1e-4);
    assert!(beyond(20.0, 0.05).abs() < 1e-6, "it is enough");
}

#[test]
fn the_pressure_has_sagged_once_its_compensation_has_risen_in_the_breath() {
    let sagged = |ticks: usize, pressure: f32| {
        let (expiration, mut state) = breaths(1, 25.0, |_| 5.0);
        (0..ticks).for_each(|_| expiration.observe(&mut state, &breath().at(1600), pressure, 0.0, || false));
        state.has_sagged()
    };
    assert!(sagged(13, 3.0) && !sagged(12, 3.0) && !sagged(1000, 4.1));
}

#[test]
fn a_breath_whose_loss_is_explained_tells_of_no_leak_and_one_without_a_loss_of_none() {
    let (expiration, mut state) = breaths_with(2, 25.0, Some(0.5), |_| 5.0);
    let mut start = |missing| expiration.judge_last(&mut state, Some(0.5), missing);
    let found = [Missing::Explained, Missing::Lost, Missing::Explained, Missing::Lost].map(&mut start);
    assert_eq!((found, start(Missing::Lost)), ([None; 4], Some(Fault::Leak)), "the fifth that counts");
    assert_eq!(expiration.judge_last(&mut state, Some(1.0), Missing::Explained), None);
    assert_eq!(expiration.judge_last(&mut state, Some(0.5), Missing::Lost), None, "from the start");
}

#[test]
fn gas_that_the_lung_keeps_is_not_lost() {
    let told = |kept: bool| {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        (0..9).any(|_| begin(&expiration, &mut state, Some(0.3), kept) == Some(Fault::Leak))
    };
    assert!(told(false) && !told(true));
    let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
    let mut start = |share, kept| begin(&expiration, &mut state, Some(share), kept).is_some();
    assert!(
        [true, true, false, true, true].map(|kept| start(0.3, kept)) == [false, false, false, false, true]
    );
    assert!(!start(1.0, false) && !(0..9).any(|_| start(0.3, true)), "each row by itself");
}

#[test]
fn nothing_is_added_to_a_pressure_above_pip() {
    let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
    expiration.learn_leak(&mut state, (5.0, 0.0), lost(0.1));
    for (pressure, flows) in [(27.0, true), (27.1, false), (24.0, true)] {
        expiration.observe(&mut state, &breath().at(1200), pressure, 0.0, || false);
        assert_eq!(state.compensation() > 5.0, flows, "{pressure} cmH2O at a PIP of 25");
    }
}

#[test]
fn a_leak_at_the_bound_needs_no_flow() {
    let expiration = Expiration::new(1000, Monitors::ALL);
    let compensation = |leak: f32| {
        let mut state = ExpirationState::default();
        expiration.learn_leak(&mut state, (1.0, 0.0), lost(leak));
        state.compensation()
    };
    assert!(compensation(0.99 * KNOWN_LEAK).abs() < 1e-6 && compensation(1.01 * KNOWN_LEAK) > 5.0);
}

#[test]
fn while_a_lung_does_not_empty_no_flow_is_added_to_it() {
    let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
    expiration.learn_leak(&mut state, (5.0, 0.0), lost(0.1));
    assert!(state.compensation() > 5.0);
    state.incomplete = 1;
    expiration.learn_leak(&mut state, (5.0, 0.0), lost(0.1));
    assert!(state.compensation().abs() < 1e-6 && (state.leak() - 0.1).abs() < 1e-6, "the leak is known");
}

#[test]
fn flow_that_holds_more_than_peep_is_halved() {
    let (expiration, _) = breaths(0, 25.0, |_| 5.0);
    let after = |smooth: f32, inhales: Option<bool>| {
        let mut state = ExpirationState { smooth, compensation: 37.0, lowest: 21.0, ..Default::default() };
        match inhales {
            None => expiration.assess(&mut state, 5.0, 0.0),
            Some(inhales) => expiration.triggered(&mut state, 5.0, false, inhales),
        }
        (state.compensation, state.lowest)
    };
    assert_eq!([after(5.5, None), after(5.51, None)], [(37.0, 21.0), (13.0, 0.0)]);
    assert_eq!([after(5.5, Some(true)), after(5.51, Some(true))], [(26.0, 21.0), (13.0, 0.0)]);
    assert_eq!([after(5.5, Some(false)), after(5.51, Some(false))], [(26.0, 37.0), (13.0, 0.0)]);
}

/// Expirations that an effort ends after so many ticks, each with this pressure until 0.1 s before their end, where the effort
/// begins, and this flow, L/s.
fn triggered(
    count: usize,
    ticks: u32,
    pressure: impl Fn(u32) -> f32,
    flow: impl Fn(u32) -> f32,
) -> ExpirationState {
    let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
    let breath = breath();
    for since in (0..count).flat_map(|_| 0..ticks) {
        let effort = 0.05 * (since + 100).saturating_sub(ticks) as f32;
        let pressure = pressure(since) - effort;
        expiration.observe(&mut state, &breath.at(1000 + since), pressure, flow(since), || false);
        if since + 1 == ticks {
            expiration.triggered(&mut state, 5.0, ticks >= 1000, true);
            begin(&expiration, &mut state, Some(1.0), false);
        }
    }
    state
}

/// A lung that empties with this time constant, ticks.
fn empties(time_constant: f32) -> impl Fn(u32) -> f32 {
    move |since: u32| (-(since as f32) / time_constant).exp()
}

#[test]
fn pip_follows_a_stuck_peep_valve_as_well_if_efforts_end_the_expirations() {
    let stuck = |since: u32| if since < 100 { 25.0 } else { 15.0 };
    let shift = |count| triggered(count, 1500, stuck, |since| -0.5 * empties(250.0)(since)).shift(&breath());
    assert!(shift(1).abs() < 1e-6 && (shift(2) - 10.0).abs() < 0.1, "{} {}", shift(1), shift(2));
    // A slow lung still empties, and the valve's own resistance lets the pressure fall a little.
    let slow = |since: u32| 15.0 + 0.8 * empties(1000.0)(since);
    let shift = triggered(2, 1500, slow, |since| -0.4 * empties(1000.0)(since)).shift(&breath());
    assert!((10.0..10.4).contains(&shift), "{shift}");
}

#[test]
fn pip_does_not_follow_gas_that_is_trapped_behind_a_resistance() {
    for time_constant in [2000.0, 3000.0, 6000.0] {
        let share = empties(time_constant);
        let state = triggered(3, 1500, |since| 5.0 + 14.0 * share(since), |since| -0.3 * share(since));
        assert!(state.shift(&breath()).abs() < 1e-6, "{time_constant} ms, and an effort");
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        for tick in (0..3).flat_map(|_| 1000..3000) {
            let share = share(tick - 1000);
            expiration.observe(&mut state, &breath().at(tick), 5.0 + 14.0 * share, -0.3 * share, || false);
            if tick == 2999 {
                begin(&expiration, &mut state, Some(1.0), false);
            }
        }
        assert!(state.shift(&breath()).abs() < 1e-6 && state.incomplete == 3, "{time_constant} ms");
    }
}

#[test]
fn an_expiration_too_short_for_a_baseline_raises_pip_no_further() {
    let (expiration, _) = breaths(0, 25.0, |_| 5.0);
    let shift = |baseline: f32| {
        let mut state = triggered(2, 1500, |_| 15.0, |_| 0.0);
        state.samples = [Sample { pressure: baseline, flow: 0.0 }; SAMPLES];
        expiration.triggered(&mut state, 5.0, false, true);
        begin(&expiration, &mut state, Some(1.0), false);
        state.shift(&breath())
    };
    assert!((shift(19.0) - 10.0).abs() < 0.1 && (shift(12.0) - 7.0).abs() < 1e-3 && shift(4.0) == 0.0);
}

#[test]
fn pip_follows_only_a_pressure_that_swings() {
    let (expiration, mut state) = breaths(2, 25.0, |_| 15.0);
    assert!(state.shift(&breath()) > 9.0);
    expiration.start_breath(&mut state, Some(1.0), false);
    assert!(state.shift(&breath()).abs() < 1e-6);
}

#[test]
fn an_expiration_that_an_effort_ends_counts_as_incomplete_by_its_pressure_before() {
    let state = triggered(2, 1500, |_| 8.1, |_| 0.0);
    assert_eq!(state.incomplete, 2, "the effort lowers the pressure to 3.1 cmH2O");
    assert_eq!(triggered(2, 1500, |_| 8.0, |_| 0.0).incomplete, 0, "at the bound");
    let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
    for (smooth, left) in [(8.1, 2), (8.0, 0)] {
        (state.incomplete, state.smooth) = (2, smooth);
        expiration.triggered(&mut state, 5.0, false, true);
        assert_eq!((state.incomplete, state.falling), (left, true), "still emptying");
    }
}

#[test]
fn pip_follows_no_more_of_a_baseline_than_is_above_the_old_peep_and_the_new_one() {
    for (rise, shift) in [(4.0, 6.0), (12.0, 0.0), (-4.0, 10.0)] {
        let (expiration, mut state) = breaths(2, 25.0, |_| 15.0);
        state.peep_changed(rise);
        begin(&expiration, &mut state, Some(1.0), false);
        assert!((state.shift(&breath()) - shift).abs() < 0.1, "{rise}: {}", state.shift(&breath()));
        assert!(!expiration.goes_on(&state, &breath().at(3000)));
    }
}

#[test]
fn noise_around_peep_is_no_sag() {
    let (_, state) = breaths(10, 25.0, |tick| if tick % 2 == 0 { 4.6 } else { 5.4 });
    assert!(state.compensation().abs() < 1e-3);
}

#[test]
fn an_expiration_that_still_falls_lasts_up_to_half_a_breath_longer() {
    let slowly = |tick: u32| 25.0 - 0.005 * tick as f32;
    let (expiration, state) = breaths(2, 25.0, slowly);
    let breath = breath();
    assert!(expiration.goes_on(&state, &breath.at(3000)) && expiration.goes_on(&state, &breath.at(4499)));
    assert!(!expiration.goes_on(&state, &breath.at(4500)));
    assert!(state.shift(&breath).abs() < 1e-6, "PIP does not rise");
    let (expiration, state) = breaths(1, 25.0, slowly);
    assert!(!expiration.goes_on(&state, &breath.at(3000)), "after the second one");
    let (mut expiration, state) = breaths(2, 25.0, slowly);
    expiration = Expiration { enabled: false, ..expiration };
    let mut without = ExpirationState { incomplete: 0, ..state };
    expiration.assess(&mut without, 5.0, 0.0);
    assert!(!expiration.goes_on(&without, &breath.at(3000)));
}

#[test]
fn pip_follows_a_constant_baseline_up_to_the_limit() {
    let (expiration, state) = breaths(2, 25.0, |_| 15.0);
    assert!((state.shift(&breath()) - 10.0).abs() < 0.1);
    assert!(!expiration.goes_on(&state, &breath().at(3000)), "it would not fall any further");
    let tight = Settings { pressure_limit: 36.0, ..paper_settings(25.0) };
    let tight = Breath::new(&tight, DEFAULT_PERIOD_US).unwrap();
    assert!((state.shift(&tight) - 4.0).abs() < 1e-3);
    let (_, back) = breaths(3, 25.0, |_| 5.0);
    assert!(back.shift(&breath()).abs() < 1e-6);
}

#[test]
fn pip_does_not_rise_if_the_gas_does_not_get_out() {
    for share in [Some(0.2), None] {
        let (_, state) = breaths_with(4, 25.0, share, |_| 15.0);
        assert!(state.shift(&breath()).abs() < 1e-6);
    }
}

#[test]
fn a_sag_of_one_raises_the_compensation_by_forty_a_second_and_its_end_lowers_it_by_eight() {
    let change = |tick, pressure, doubtful| {
        let mut state = ExpirationState { compensation: 10.0, ..ExpirationState::default() };
        let expiration = Expiration::new(1000, Monitors::ALL);
        expiration.observe(&mut state, &breath().at(tick), pressure, 0.0, || doubtful);
        (1e4 * (state.compensation() - 10.0) + 0.5).floor() as i32
    };
    assert_eq!((change(2000, 3.0, false), change(2000, 3.5, false)), (400, 200));
    assert_eq!((change(2000, 4.0, false), change(2000, 3.0, true)), (-80, -80), "no sag");
    assert_eq!((change(1499, 3.0, false), change(1500, 3.0, false)), (0, 400), "from the end of the fall on");
}

#[test]
fn an_expiration_at_a_bound_is_on_its_better_side() {
    let (expiration, breath) = (Expiration::new(1000, Monitors::ALL), breath());
    let second = |smooth, earlier| {
        let samples = [Sample { pressure: earlier, flow: 0.0 }; SAMPLES];
        let mut state = ExpirationState { smooth, samples, incomplete: 1, ..ExpirationState::default() };
        expiration.assess(&mut state, 5.0, 0.0);
        (state.incomplete, state.falling, expiration.goes_on(&state, &breath.at(3000)))
    };
    assert_eq!(second(8.0, 9.0), (0, true, false), "3 cmH2O above PEEP");
    assert_eq!(second(8.1, 9.0), (2, true, true));
    assert_eq!(second(8.5, 9.0), (2, false, false), "a fall of half a cmH2O");
    let state = ExpirationState { smooth: 8.0, incomplete: 2, falling: true, ..ExpirationState::default() };
    assert!(!expiration.goes_on(&state, &breath.at(3000)));
}

#[test]
fn the_shares_of_a_leak_and_of_gas_that_comes_out_are_exact() {
    let expiration = Expiration::new(1000, Monitors::ALL);
    let started = |compensation, share| {
        let mut state =
            ExpirationState { compensation, leaks: LEAKS - 1, above: 10.0, ..ExpirationState::default() };
        (begin(&expiration, &mut state, Some(share), false).is_some(), state.shift(&breath()) > 9.0)
    };
    assert_eq!([started(LEAK, 0.6), started(LEAK, 0.59)], [(false, true), (true, true)]);
    assert_eq!([started(5.1, TIGHT), started(5.1, 0.74)], [(false, true), (true, true)]);
    assert_eq!([started(0.0, 0.5), started(0.0, 0.49)], [(true, true), (true, false)]);
}

#[test]
fn a_short_expiration_that_still_falls_lasts_longer_and_pip_does_not_rise() {
    // At 60 breaths a minute expiration and fall take 0.6 s, of which the fall takes 0.17.
    let settings = Settings { rate: 60.0, inspiratory_time: 0.4, fall_time: 0.17, ..paper_settings(25.0) };
    let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
    let (expiration, mut state) = (Expiration::new(1000, Monitors::ALL), ExpirationState::default());
    for tick in (0..3).flat_map(|_| 0..1000_u32) {
        let pressure = 25.0 - 0.02 * tick.saturating_sub(400) as f32;
        expiration.observe(&mut state, &breath.at(tick), pressure, 0.0, || false);
        if tick == 999 {
            begin(&expiration, &mut state, Some(1.0), false);
        }
    }
    assert!(expiration.goes_on(&state, &breath.at(1000)));
    assert!(state.shift(&breath).abs() < 1e-6);
}

#[test]
fn pip_is_never_lowered_however_close_the_limit() {
    let close = Settings { pressure_limit: 30.0, ..paper_settings(25.0) };
    let close = Breath::new(&close, DEFAULT_PERIOD_US).unwrap();
    for shift in [0.0, 10.0] {
        let state = ExpirationState { shift, ..ExpirationState::default() };
        assert!(state.shift(&close).abs() < 1e-6, "{}", state.shift(&close));
    }
}

#[test]
fn gas_is_lost_after_two_empty_expirations_or_ten_of_any_kind() {
    let even_after = |flow: fn(u32) -> f32| {
        let mut state = ExpirationState::default();
        (1..20).find(|number| {
            state.note_outflow(flow(*number));
            state.is_even()
        })
    };
    assert_eq!(even_after(|_| 0.0), Some(2));
    assert_eq!(even_after(|_| -0.1), Some(10), "a lung that never empties");
    assert_eq!(
        even_after(|number| if number == 1 { 0.0 } else { -0.1 }),
        Some(10),
        "an effort hides the first outflow"
    );
}
