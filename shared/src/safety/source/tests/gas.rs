//! Tests of two sensors that are far apart while gas goes in.

use super::*;

/// Ticks of an inspiration with a flow of the valve, L/s, at the pressures of airway and outlet by the tick; the last choice.
fn inspiration(run: &mut Run, flow: f32, pressures: impl Fn(u32) -> (f32, f32)) -> Chosen {
    let breath = Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap();
    let choices = (0..300).map(|tick| {
        let (airway, outlet) = pressures(tick);
        let noise = |shift: u32| 0.07 * (((tick + shift) * 7 % 5) as f32 - 2.0);
        let readings = Readings { airway: airway + noise(0), outlet: outlet + noise(2), flow };
        let chosen = run.source.check(&mut run.state, &readings, Expected::Any, flow);
        run.source.record(&mut run.state, &breath.at(tick), 50, &readings, flow);
        chosen
    });
    choices.last().unwrap_or_default()
}

#[test]
fn a_sensor_that_stays_up_in_the_fall_belies_no_other_while_a_leak_takes_gas() {
    let mut run = Run::new();
    run.ticks(100, PEEP, PEEP);
    inspiration(&mut run, 0.5, |_| (25.0, 25.0));
    run.source.inspired(&mut run.state, 0.0, false);
    let breath = Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap();
    for tick in 1500..1600 {
        let readings = Readings { airway: 10.0 + 0.01 * (tick % 3) as f32, outlet: 25.0, flow: 0.2 };
        run.source.check(&mut run.state, &readings, Expected::Any, 0.2);
        run.source.record(&mut run.state, &breath.at(tick), 50, &readings, 0.2);
        assert!(run.state.airway.is_sound() && !run.state.airway.doubted);
    }
}

#[test]
fn while_gas_goes_in_the_sensor_that_follows_it_is_believed_until_rest_tells_more() {
    let rises = |tick: u32| PEEP + (0.3 * tick as f32).min(20.0);
    let lags = |tick: u32| rises(tick.saturating_sub(100));
    let mut run = Run::new();
    run.ticks(100, PEEP, PEEP);
    assert!(near(inspiration(&mut run, 0.5, |tick| (lags(tick.min(160)), rises(tick))), 25.0));
    assert!(
        run.state.inspiration == Inspiration::Undecided
            && !run.state.airway.is_sound()
            && run.state.outlet.is_sound()
    );
    assert!(near(run.ticks(100, 20.0, 8.0), 8.0), "in the fall it lags as well");
    assert!((0..2).all(|_| !run.expiration(PEEP, PEEP, 0.0)) && run.state.airway.doubted);
    run.expiration(PEEP, PEEP, 0.0);
    assert!(
        !run.state.airway.doubted && run.state.inspiration != Inspiration::Undecided,
        "agreed in three expirations"
    );
    // An offset follows the gas: PEEP tells which one has it, in one expiration.
    let mut run = Run::new();
    run.ticks(100, PEEP, 12.0 + PEEP);
    assert!(near(inspiration(&mut run, 0.5, |tick| (rises(tick), 12.0 + rises(tick))), 37.0));
    assert!(run.state.inspiration != Inspiration::Undecided, "the higher one counts");
    // One that stands still does not follow, and two expirations elsewhere decide.
    let mut run = Run::new();
    run.ticks(100, 8.0, PEEP);
    assert!(
        near(inspiration(&mut run, 0.5, |tick| (8.0, rises(tick))), 25.0)
            && run.state.inspiration == Inspiration::Undecided
    );
    assert!(
        !run.expiration(8.0, PEEP, 0.0) && run.state.inspiration == Inspiration::Undecided,
        "it may be a strain's"
    );
    assert!(
        run.expiration(8.0, PEEP, 0.0)
            && run.state.airway.doubted
            && run.state.inspiration != Inspiration::Undecided
    );
}

#[test]
fn a_sensor_that_stood_still_while_the_other_one_breathed_is_wrong_whatever_an_effort_shows_at_rest() {
    let rises = |tick: u32| PEEP + (0.3 * tick as f32).min(20.0);
    for airway_wrong in [false, true] {
        let stands = |breathes: f32| if airway_wrong { (13.0, breathes) } else { (breathes, 13.0) };
        let mut run = Run::new();
        let (airway, outlet) = stands(PEEP);
        run.ticks(100, airway, outlet);
        let (airway, outlet) = stands(PEEP - 9.0);
        for _ in 0..4 {
            inspiration(&mut run, 0.05, |tick| stands(rises(tick)));
            assert!(run.source.inspired(&mut run.state, 0.0, false));
            assert!(!run.expiration(airway, outlet, 0.0), "an effort");
        }
        assert_eq!((run.state.airway.doubted, run.state.outlet.doubted), (airway_wrong, !airway_wrong));
        // Both breathe: rest tells again which of them is off.
        inspiration(&mut run, 0.05, |tick| (rises(tick), rises(tick)));
        assert!(!run.source.inspired(&mut run.state, 0.0, false));
        assert!((0..2).any(|_| run.expiration(airway, outlet, 0.0)));
        assert_eq!((run.state.airway.doubted, run.state.outlet.doubted), (!airway_wrong, airway_wrong));
    }
    for (highest, flow, cut) in [(9.0, 0.0, false), (12.0, 1.0, false), (25.0, 0.0, true)] {
        let mut run = Run::new();
        run.ticks(100, PEEP, PEEP);
        inspiration(&mut run, 0.05, |tick| (PEEP, rises(tick).min(highest)));
        assert!(
            !run.source.inspired(&mut run.state, flow, cut),
            "the tube explains it, or the way back to PEEP"
        );
    }
    let mut run = Run::new();
    run.ticks(100, PEEP, PEEP);
    run.ticks(50, 500.0, PEEP);
    inspiration(&mut run, 0.05, |tick| (PEEP, rises(tick)));
    assert!(run.state.is_one_lost() && !run.source.inspired(&mut run.state, 0.0, false), "it has its alarm");
}

#[test]
fn either_sensor_may_be_the_one_that_does_not_follow_the_gas() {
    let rises = |tick: u32| PEEP + (0.3 * tick as f32).min(20.0);
    for outlet_stays in [false, true] {
        let mut run = Run::new();
        run.ticks(100, PEEP, PEEP);
        let pressures = |tick| if outlet_stays { (rises(tick), PEEP) } else { (PEEP, rises(tick)) };
        assert!(near(inspiration(&mut run, 0.5, pressures), 25.0));
        assert_eq!([run.state.airway.doubted, run.state.outlet.doubted], [!outlet_stays, outlet_stays]);
    }
}

#[test]
fn a_sensor_is_not_doubted_by_a_flow_that_fills_no_lung() {
    let doubted = |flow: f32| {
        let mut run = Run::new();
        run.ticks(100, PEEP, PEEP);
        inspiration(&mut run, flow, |tick| (PEEP, PEEP + (0.3 * tick as f32).min(20.0)));
        run.state.airway.doubted
    };
    assert_eq!([0.0, FILLS, 0.125].map(doubted), [false, false, true]);
}

#[test]
fn a_sensor_is_doubted_only_if_it_follows_by_less_than_the_bound_allows() {
    let doubted = |rises: [f32; 2]| {
        let mut state = SourceState { starts: Some([PEEP; 2]), ..SourceState::default() };
        (state.airway.smooth, state.outlet.smooth) = (PEEP + rises[0], PEEP + rises[1]);
        state.doubt_what_stays();
        (state.airway.doubted, state.outlet.doubted)
    };
    assert_eq!([[8.0, 13.0], [13.0, 8.0]].map(doubted), [(false, false); 2]);
    assert_eq!([[8.0, 13.125], [13.125, 8.0]].map(doubted), [(true, false), (false, true)]);
}

#[test]
fn an_expiration_that_tells_nothing_leaves_the_sensors_undecided() {
    let mut run = Run::new();
    run.ticks(100, PEEP, PEEP);
    inspiration(&mut run, 0.5, |tick| (PEEP, PEEP + (0.3 * tick as f32).min(20.0)));
    // Neither close enough to agree nor so far apart that one is wrong.
    assert!(!run.expiration(PEEP + 1.5, PEEP, 0.0) && run.state.inspiration == Inspiration::Undecided);
    assert!(
        !run.expiration(PEEP + 0.5, PEEP, 0.0) && run.state.inspiration != Inspiration::Undecided,
        "they agree"
    );
}

#[test]
fn the_drop_in_the_tube_belongs_to_what_the_airway_shows_of_the_outlet() {
    let of_airway = |flow: f32| {
        let mut run = Run::new();
        run.ticks(100, PEEP, PEEP);
        // Far apart, so that the outlet sensor, the higher one, is used.
        inspiration(&mut run, flow, |_| (10.0, 30.0)).other.map(f32::round)
    };
    assert_eq!([0.0, 1.0].map(of_airway), [Some(10.0), Some(14.0)]);
}
