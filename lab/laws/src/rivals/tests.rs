//! The registry, and what holds for every rival.

use proptest::prelude::*;
use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
use shared::control::pid::{Pid, PidGains};
use shared::control::{ControlLaw, Controller, Observation};
use shared::ventilator::Ventilator;

use super::*;
use learn::controller::Trainable;
use learn::controller::authors::{AuthorsController, AuthorsSpec};
use plant::bench::BenchConfig;
use trials::robust::plant_run::{PlantRun, breaths};

fn machine() -> Machine {
    Machine::of(&BenchConfig::default())
}

/// The rival with its tuned values.
fn tuned(rival: Rival) -> AnyLaw {
    rival.law(&rival.tuned(), machine(), DEFAULT_PERIOD_US).unwrap()
}

fn pid() -> Controller {
    Controller::Pid(Pid::new(PidGains { p: 5.0, i: 200.0, d: 0.1 }, DEFAULT_PERIOD_US).unwrap())
}

fn run() -> PlantRun {
    PlantRun {
        bench: BenchConfig::paper(20.0, 20.0),
        settings: paper_settings(20.0),
        noise: 1,
        breaths: 3,
        goes_on: false,
    }
}

#[test]
fn every_rival_is_found_by_its_name_and_no_other() {
    for rival in Rival::ALL {
        assert_eq!(Rival::find(rival.name()), Some(rival));
    }
    assert_eq!(Rival::find("adult"), None);
}

#[test]
fn a_rival_needs_one_value_for_each_parameter_within_its_bounds() {
    for rival in Rival::ALL {
        let refusal = rival.law(&[1.0], machine(), DEFAULT_PERIOD_US).unwrap_err().to_string();
        assert!(refusal.contains(rival.name()), "{refusal}");
        for place in 0..rival.parameters().len() {
            let mut values = rival.tuned();
            values[place] = f32::NAN;
            assert!(rival.law(&values, machine(), DEFAULT_PERIOD_US).is_err(), "{} {place}", rival.name());
        }
    }
}

#[test]
fn a_controller_of_a_device_gives_the_same_breaths_as_alone() {
    assert_eq!(breaths(&run(), &AnyLaw::new(pid())).unwrap(), breaths(&run(), &pid()).unwrap());
}

#[test]
fn every_rival_ventilates_the_nominal_lung() {
    for rival in Rival::ALL {
        let found = breaths(&run(), &tuned(rival)).unwrap();
        assert!(found.every.len() == 3 && !found.unstable, "{}", rival.name());
        assert!(found.every.iter().all(|score| *score < 3.0), "{}: {:?}", rival.name(), found.every);
    }
}

#[test]
fn only_laws_that_learn_a_feed_forward_have_a_learning_rule_and_only_a_controller_runs_on_a_device() {
    for rival in Rival::ALL {
        let learns = [Rival::Iterative, Rival::Gated].contains(&rival);
        assert_eq!(learning(&tuned(rival)).is_some(), learns);
        assert_eq!(tuned(rival).chip(), None);
    }
    assert_eq!(AnyLaw::new(pid()).chip(), Some(&pid()));
}

#[test]
fn a_change_of_the_law_within_a_breath_is_possible() {
    let mut ventilator = Ventilator::new(DEFAULT_PERIOD_US, AnyLaw::new(pid()));
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    state.start();
    for tick in 0..900 {
        let rival = Rival::ALL[tick / 100 % Rival::ALL.len()];
        if tick % 100 == 0 {
            ventilator.set_controller(tuned(rival));
        }
        let command = ventilator.step(&mut state, 15.0).command.u_in();
        // A network that has not seen the beginning of the breath may close the valve.
        assert!(command > 0.0 || tick < 300 || rival == Rival::Gated, "{tick}: the error asks for flow");
    }
}

proptest! {
    /// The ventilator withholds readings that are no number.
    #[test]
    fn no_reading_brings_the_command_of_a_rival_out_of_the_valves_range(
        readings in prop::collection::vec(-20.0f32..90.0, 1..80),
        rival in prop::sample::select(Rival::ALL.to_vec()),
    ) {
        let law = tuned(rival);
        let mut state = law.initial_state();
        law.start_breath(&mut state, 0.0);
        for (tick, pressure) in (0..).zip(readings.iter().cycle().take(1000)) {
            let seen = Observation { pressure: *pressure, target: 20.0, pip: 20.0, peep: 5.0, tick, rise_ticks: 0 };
            let command = law.step(&mut state, &seen).command;
            prop_assert!((0.0..=100.0).contains(&command), "{command}");
            law.applied(&mut state, command);
        }
    }
}

#[test]
fn the_authors_controller_among_the_laws_runs_as_it_does_alone() {
    let spec = AuthorsSpec {
        period_us: DEFAULT_PERIOD_US,
        gains: PidGains { p: 5.0, i: 200.0, d: 0.1 },
        lambda: 1.0,
        authority: 100.0,
        error_spacing_us: 5000,
    };
    let mut parameters = vec![0.0; AuthorsController::size()];
    let still = AuthorsController::new(spec, &parameters).unwrap();
    assert_eq!(breaths(&run(), &AnyLaw::new(still)).unwrap(), breaths(&run(), &pid()).unwrap());
    *parameters.last_mut().unwrap() = 0.1;
    let law = AuthorsController::new(spec, &parameters).unwrap();
    let alone = breaths(&run(), &law).unwrap();
    assert_eq!(breaths(&run(), &AnyLaw::new(law.clone())).unwrap(), alone);
    assert_ne!(alone, breaths(&run(), &pid()).unwrap());
    assert_eq!(AnyLaw::new(law).chip(), None);
}
