//! The authors' controller in training and as a law.

use super::*;
use crate::controller::learned::{Learned, LearnedError, Origin, architecture};
use crate::controller::rollout::{ClosedLoopTape, LaneController};
use crate::controller::{PlantModels, Stepwise, TrainConfig, Training};
use crate::simulator::first_order;
use crate::simulator::model::{Architecture, Model};
use crate::simulator::state_space::StateSpaceConfig;
use engine::LANES;
use rand_chacha::rand_core::SeedableRng;

fn spec(error_spacing_us: u32) -> AuthorsSpec {
    let gains = PidGains { p: 0.6, i: 3.0, d: 0.004 };
    AuthorsSpec { period_us: 1000, gains, lambda: 0.3, authority: 100.0, error_spacing_us }
}

/// A network that keeps the valve about half open.
fn parameters() -> Vec<f32> {
    let mut parameters = initial_parameters(&mut ChaCha8Rng::seed_from_u64(5));
    for (n, weight) in parameters[600..].iter_mut().enumerate() {
        *weight = 0.02 * (n as f32).sin();
    }
    parameters[PARAMETERS - 1] = 1.6;
    parameters
}

fn model() -> Model {
    let config = StateSpaceConfig { states: 6, hidden: 8, ..StateSpaceConfig::for_period(1000, 1) };
    let architecture = Architecture::StateSpace(config);
    Model::new(architecture, &architecture.initialise(&mut ChaCha8Rng::seed_from_u64(2)))
}

fn scenario(ticks: usize) -> Scenario {
    let noise = (0..ticks).map(|n| Lane::from_fn(|l| 0.1 * ((n * 7 + l) as f32).sin())).collect();
    Scenario { noise, ..Scenario::plain(ticks, Lane::from_fn(|l| 16.0 + 0.5 * l as f32)) }
}

#[test]
fn errors_are_the_nearest_whole_number_of_ticks_apart() {
    for (period_us, ticks) in [(1000, 10), (4000, 3), (6000, 2), (7000, 1), (30_000, 1)] {
        assert_eq!(spacing_ticks(10_000, period_us), ticks, "{period_us} us");
        let spec = AuthorsSpec { period_us, ..spec(10_000) };
        assert_eq!(AuthorsController::new(spec, &parameters()).unwrap().spacing(), ticks, "{period_us} us");
    }
    assert_eq!((spacing_ticks(0, 1000), spacing_ticks(u32::MAX, 1000)), (1, 4_294_967));
}

#[test]
fn lanes_and_law_give_the_same_commands() {
    let controller = AuthorsController::new(spec(7000), &parameters()).unwrap();
    let (model, scenario) = (model(), scenario(200));
    let lanes = LaneController::new(&controller, &parameters());
    let mut tape = ClosedLoopTape::<AuthorsController>::new(&model, scenario.ticks);
    lanes.forward(&model, &scenario, &mut tape);
    for l in [0, LANES - 1] {
        let mut state = controller.initial_state();
        controller.start_breath(&mut state, 5.0);
        for tick in 0..scenario.ticks {
            let pip = scenario.prescribed.pip[l];
            let pressure = pip - tape.signals().error[tick][l];
            let seen =
                Observation { pressure, target: pip, pip, peep: 5.0, tick: tick as u32, rise_ticks: 0 };
            let command = controller.step(&mut state, &seen).command;
            assert!((command - tape.signals().command[tick][l]).abs() < 1e-2, "tick {tick}");
        }
    }
}

#[test]
fn the_gradient_of_a_rollout_agrees_with_finite_differences() {
    let (controller, mut parameters) =
        (AuthorsController::new(spec(3000), &parameters()).unwrap(), parameters());
    let (model, scenario) = (model(), scenario(100));
    let mut tape = ClosedLoopTape::<AuthorsController>::new(&model, scenario.ticks);
    let lanes = LaneController::new(&controller, &parameters);
    lanes.forward(&model, &scenario, &mut tape);
    let mut gradient = vec![0.0; PARAMETERS];
    lanes.backward(&scenario, &mut tape, &mut gradient);

    let largest = gradient.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
    let (step, mut told) = (2e-3, 0);
    for n in (0..PARAMETERS).step_by(13).chain([PARAMETERS - 1]) {
        let kept = parameters[n];
        let mut loss = |value| {
            parameters[n] = value;
            LaneController::new(&controller, &parameters).forward(&model, &scenario, &mut tape).weighted
        };
        let numeric = (loss(kept + step) - loss(kept - step)) / f64::from(2.0 * step);
        loss(kept);
        let error = (numeric - f64::from(gradient[n])).abs();
        assert!(
            error < 0.03 * f64::from(gradient[n].abs() + 0.2 * largest),
            "{n}: {numeric} {}",
            gradient[n]
        );
        told += usize::from(gradient[n].abs() > 0.05 * largest);
    }
    assert!(told > 10, "only {told} gradients were large enough to tell anything");
}

#[test]
fn only_errors_are_seen() {
    let controller = AuthorsController::new(spec(5000), &parameters()).unwrap();
    let run = |offset: f32, applied: f32| {
        let mut state = controller.initial_state();
        controller.start_breath(&mut state, applied);
        let command = |tick: u32| {
            let (pip, peep) = (20.0 + offset, 5.0 + 0.1 * offset);
            let pressure = pip - 10.0 + 0.125 * tick as f32;
            let seen =
                Observation { pressure, target: pip, pip, peep, tick: tick + applied as u32, rise_ticks: 0 };
            let command = controller.step(&mut state, &seen).command;
            controller.applied(&mut state, applied);
            command
        };
        (0..60).map(command).collect::<Vec<_>>()
    };
    assert_eq!(run(0.0, 5.0), run(8.0, 90.0));
}

#[test]
fn an_error_is_remembered_for_nine_spacings_and_no_longer() {
    let flat = AuthorsSpec { gains: PidGains::default(), ..spec(5000) };
    let controller = AuthorsController::new(flat, &parameters()).unwrap();
    let command_after = |first_error: f32, ticks: usize| {
        let mut state = controller.initial_state();
        let seen = |error| Observation {
            pressure: 20.0 - error,
            target: 20.0,
            pip: 20.0,
            peep: 5.0,
            tick: 0,
            rise_ticks: 0,
        };
        controller.step(&mut state, &seen(first_error));
        (0..ticks).map(|_| controller.step(&mut state, &seen(1.0)).command).last().unwrap().to_bits()
    };
    assert_ne!(command_after(1.0, 45), command_after(15.0, 45));
    assert_eq!(command_after(1.0, 46), command_after(15.0, 46));
}

#[test]
fn training_beats_its_pid_and_the_file_names_the_architecture() {
    let spec = AuthorsSpec { gains: PidGains { p: 1.0, i: 20.0, d: 0.0 }, lambda: 1.0, ..spec(5000) };
    let config = TrainConfig { iterations: 60, batch: 16, validate_every: 20, ..TrainConfig::default() };
    let simulator = first_order(1.0);
    let plant = PlantModels { trained_on: std::slice::from_ref(&simulator), held_out: &simulator };
    let mut training = Training::<AuthorsController>::of(spec, &[plant], config, None).unwrap();
    while training.advance().is_some() {}
    let trained = training.finish().unwrap();
    assert!(trained.improved && trained.validation < 0.8 * trained.base, "{trained:?}");

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("controller.safetensors");
    let learned = Learned { controller: trained.controller, origin: Origin::default() };
    learned.save(&path).unwrap();
    assert_eq!(Learned::<AuthorsController>::read(&path).unwrap(), learned);
    assert_eq!(architecture(&path).unwrap(), "authors");
    let refused = Learned::load(&path).unwrap_err();
    assert!(matches!(refused, LearnedError::Architecture { .. }), "{refused}");
    assert!(refused.to_string().contains("runs on the host"), "{refused}");
}

#[test]
fn what_is_out_of_range_is_refused() {
    let far = AuthorsController::new(spec(ERROR_SPACING_MAX_US + 1), &parameters());
    assert!(matches!(far, Err(ResidualError::OutOfBounds { .. })));
    let mut wild = parameters();
    wild[7] = f32::NAN;
    assert_eq!(AuthorsController::new(spec(5000), &wild), Err(ResidualError::Weights));
}
