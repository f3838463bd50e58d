//! A sweep of sines in the command.

use super::*;
use crate::explore::sines::SineSweep;

const SWEEP: SineSweep = SineSweep {
    amplitude: 10.0,
    lowest_hz: 5.0,
    ratio: 1.0,
    frequencies: 1,
    phases: 8,
    first_breath: 0,
    from_s: 0.2,
};

/// Asks for a constant command, and remembers what it was told last.
struct Told;

impl ControlLaw for Told {
    type State = f32;

    fn initial_state(&self) -> f32 {
        0.0
    }

    fn start_breath(&self, _: &mut f32, _: f32) {}

    fn step(&self, _: &mut f32, _: &Observation) -> ControlOutput {
        ControlOutput::plain(5.0)
    }

    fn applied(&self, state: &mut f32, command: f32) {
        *state = command;
    }
}

fn sweeping() -> Ventilator<Told> {
    // The monitors for any plant, and that of a leak.
    let others = Fault::all().filter(|fault| !Monitors::ANY_PLANT.has(*fault) && *fault != Fault::Leak);
    let monitors = others.fold(Monitors::ALL, Monitors::without);
    let mut ventilator = Ventilator::new(DEFAULT_PERIOD_US, Told).with_monitors(monitors);
    ventilator.set_sweep(Some(SWEEP));
    ventilator
}

fn breathing(ventilator: &Ventilator<Told>) -> VentilatorState<f32> {
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    state.start();
    state
}

#[test]
fn a_sine_is_added_within_the_valves_range_and_the_law_is_told_its_own_command() {
    let ventilator = sweeping();
    let mut state = breathing(&ventilator);
    for breath in 0..9 {
        let sine = SWEEP.sine(breath, DEFAULT_PERIOD_US);
        for tick in 0..3000 {
            let pressure = if tick < 1000 { 15.0 } else { 5.0 };
            let sample = ventilator.step(&mut state, pressure).sample.unwrap();
            if tick < 1000 {
                let added = sine.map_or(0.0, |sine| sine.at(tick));
                assert_eq!(sample.explore.to_bits(), added.to_bits(), "{breath} {tick}");
                assert!((sample.u_in - (5.0 + added).max(0.0)).abs() < 1e-5, "{breath} {tick}: {sample:?}");
                assert!((state.controller - 5.0).abs() < 1e-5, "{breath} {tick}: {}", state.controller);
            } else {
                assert!(sample.explore == 0.0, "only in an inspiration");
            }
        }
        assert_eq!(sine.is_some(), breath < 8);
    }
}

#[test]
fn an_alarm_ends_the_sine_of_the_breath_and_none_begins_before_it_has_ended() {
    let ventilator = sweeping();
    let mut state = breathing(&ventilator);
    let mut explored = |raised| {
        let mut moved = [0; 2];
        for tick in 0..3000 {
            if let (500, Some(fault)) = (tick, raised) {
                ventilator.raise(&mut state, fault);
            }
            let pressure = if tick < 1000 { 15.0 } else { 5.0 };
            let sample = ventilator.step(&mut state, pressure).sample.unwrap();
            assert_eq!(
                raised.is_some_and(|fault| state.indications().present().has(fault)),
                raised.is_some() && tick >= 500
            );
            moved[usize::from(tick >= 500)] += u32::from(sample.explore != 0.0);
        }
        assert_eq!(state.level(), Level::Learned, "the alarm takes nothing from the controller");
        moved
    };
    let [before, after] = explored(Some(Fault::Leak));
    assert!(before >= 290 && after >= 490, "a leak is measured: {before} {after}");
    let [before, after] = explored(Some(Fault::HighPressure));
    assert!(before >= 290 && after == 0, "{before} {after}");
    // It stays for two breaths without a finding.
    assert_eq!(explored(None), [0, 0]);
}

#[test]
fn no_sine_is_added_below_the_top_of_the_ladder() {
    let mut ventilator = learned(0.0);
    ventilator.set_sweep(Some(SineSweep { from_s: 0.0, ..SWEEP }));
    let explored = |resumed: bool| {
        let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
        if resumed {
            state.resume();
        } else {
            state.start();
        }
        run(&ventilator, &mut state, 50, 15.0).sample.unwrap().explore != 0.0
    };
    assert!(explored(false) && !explored(true));
}
