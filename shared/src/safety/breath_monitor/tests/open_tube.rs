//! A tube that may be open is told by the gas that comes back.

use super::*;

/// A breath into a tube at the pressures of inspiration and expiration; the gas that the flow sensor shows, which is half of the valve's.
fn tube(peep: f32, pressures: (f32, f32), gas: (Option<f32>, f32)) -> Vec<(usize, Fault)> {
    tube_of(peep, pressures, gas, 2.0 * gas.0.unwrap_or(0.0))
}

/// The same with another volume of the valve.
fn tube_of(peep: f32, pressures: (f32, f32), gas: (Option<f32>, f32), volume: f32) -> Vec<(usize, Fault)> {
    let settings = Settings { peep, ..paper_settings(25.0) };
    let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
    let monitor = BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL);
    let mut state = BreathState::default();
    let ticks = 0..breath.total_ticks();
    let input = |tick| {
        let pressure = if breath.phase(tick) == Phase::Inspiration { pressures.0 } else { pressures.1 };
        let (inspired, returned) = gas;
        // Too little for what flows at once to be a disconnection.
        BreathInput { pressure, command: FILLING, volume, inspired, returned, ..GOOD.at(&breath, tick) }
    };
    let mut found: Vec<_> =
        ticks.map(|tick| (tick as usize, monitor.check(&mut state, &input(tick)))).collect();
    found.retain(|(_, fault)| fault.is_some());
    found.into_iter().filter_map(|(tick, fault)| Some((tick, fault?))).take(1).collect()
}

#[test]
fn gas_that_does_not_come_back_from_the_rooms_pressure_shows_an_open_tube_at_any_peep() {
    let gone = |peep, pressures, gas| tube(peep, pressures, gas) == [(2999, Fault::Disconnection)];
    for peep in [0.0, 1.0, 2.0, 5.0, 20.0] {
        assert!(gone(peep, (0.2, 0.0), (Some(300.0), 0.0)), "PEEP {peep}");
        assert!(gone(peep, (-0.5, -0.5), (Some(20.0), 15.9)), "PEEP {peep}, an offset of the sensor");
    }
    let open = (0.2, 0.0);
    assert_eq!(tube(0.0, open, (Some(300.0), 72.0)), [], "gas comes back");
    assert_eq!(tube(0.0, open, (Some(19.9), 0.0)), [], "hardly any gas");
    assert_eq!(tube(0.0, open, (None, 0.0)), [], "no flow sensor");
    assert_eq!(tube_of(0.0, open, (Some(300.0), 0.0), 601.0), [], "the valve gives too little");
    assert_eq!(tube(0.0, (1.5, 0.0), (Some(300.0), 0.0)), [], "the pressure has risen");
    assert_eq!(tube(0.0, (-2.0, 0.0), (Some(300.0), 0.0)), [], "an effort");
    assert_eq!(tube(0.0, (0.2, 1.5), (Some(300.0), 0.0)), [], "gas that is still there");
}

#[test]
fn gas_that_refills_the_lung_need_not_come_back() {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    let found = |refill: f32| {
        let mut state = BreathState::default();
        (0..breath.total_ticks()).any(|tick| {
            let input = GOOD.at(&breath, tick);
            let input = BreathInput { pressure: 0.2, inspired: Some(800.0), refill, ..input };
            monitor.check(&mut state, &input) == Some(Fault::Disconnection)
        })
    };
    // Of the 400 mL that the valve has given, half reaches the tube.
    assert!(found(599.0) && !found(601.0));
}

#[test]
fn gas_has_two_seconds_to_come_back() {
    let settings = Settings { peep: 0.0, rate: 4.0, ..paper_settings(25.0) };
    let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
    let monitor = BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL);
    let found_at = |returned: f32| {
        let mut state = BreathState::default();
        (0..breath.total_ticks()).find(|tick| {
            let returned = if *tick < 3000 { 0.0 } else { returned };
            let input =
                BreathInput { pressure: 0.2, inspired: Some(300.0), returned, ..GOOD.at(&breath, *tick) };
            monitor.check(&mut state, &input) == Some(Fault::Disconnection)
        })
    };
    assert_eq!((found_at(0.0), found_at(100.0)), (Some(3000), None));
}

#[test]
fn the_end_of_the_inspiration_tells_whether_the_tube_is_open() {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    let found = |falls: u32, doubt: bool| {
        let mut state = BreathState::default();
        (0..breath.total_ticks()).any(|tick| {
            let pressure = if tick < falls { 20.0 } else { 0.2 };
            if doubt && tick == 999 {
                state.doubt();
            }
            let cut = doubt && tick >= 999;
            let input = BreathInput { pressure, cut, inspired: Some(300.0), ..GOOD.at(&breath, tick) };
            monitor.check(&mut state, &input) == Some(Fault::Disconnection)
        })
    };
    assert!(found(960, false) && !found(961, false), "40 ms");
    assert!(found(998, true), "an inspiration that a doubt has ended");
}

#[test]
fn at_a_low_peep_the_patient_is_back_above_an_open_tubes_pressure() {
    let settings = Settings { peep: 0.0, ..paper_settings(25.0) };
    let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
    let monitor = BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL);
    let back = |pressure: f32| {
        let mut state = BreathState { disconnected: true, ..BreathState::default() };
        (0..50).for_each(|tick| {
            monitor.check(&mut state, &BreathInput { pressure, ..GOOD.at(&breath, tick) });
        });
        !state.is_disconnected()
    };
    assert!(!back(2.5) && back(2.6));
}

#[test]
fn an_effort_that_pulls_the_pressure_below_the_rooms_shows_a_closed_tube() {
    let pulled = Seen { plateau: -2.0, before: -2.0, command: 100.0, ..GOOD };
    assert_eq!(complaint(&[GOOD, pulled]), None);
    let open = Seen { plateau: -1.9, before: -1.9, ..pulled };
    assert_eq!(complaint(&[GOOD, open]), Some((1, Fault::Disconnection)));
}

#[test]
fn a_tube_that_was_open_stays_in_doubt_when_settings_change() {
    let mut state = BreathState::default();
    state.doubt();
    state.settings_changed(5.0);
    assert_eq!(state.open, u32::MAX);
}
