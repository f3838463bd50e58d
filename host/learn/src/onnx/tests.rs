//! The structure of the files and what they compute, in a small interpreter; `examples/python/onnx_check.py` compares it in onnxruntime.

mod interpreter;

use std::collections::BTreeSet;

use prost::Message;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use shared::control::features::FeatureSpec;
use shared::control::memory::Lesson::{self, Adopt, Discard, Forget};
use shared::control::pid::PidGains;
use shared::control::residual::{Residual, ResidualSpec};
use shared::control::{ControlLaw, Controller, Observation};

use interpreter::{Interpreter, Matrix};

use super::{OnnxError, authors, check, residual, simulator};
use crate::controller::architecture::Trainable;
use crate::controller::authors::{AuthorsController, AuthorsSpec};
use crate::controller::network::{chip_network, initial_parameters};
use crate::graph::proto::{Model, OPSET, Size};
use crate::simulator::hybrid::HybridConfig;
use crate::simulator::model::{Architecture, Simulator};
use crate::simulator::state_space::StateSpaceConfig;
use crate::simulator::stitched::StitchedConfig;
use crate::simulator::unit::UnitConfig;

/// Full scale of commands, percent, and pressures, cmH2O, and the largest difference.
const TOLERANCE: f32 = 1e-6 * 100.0;

const GAINS: PidGains = PidGains { p: 4.0, i: 80.0, d: 0.05 };

fn learned(seed: u64) -> Residual {
    let mut parameters = initial_parameters(&mut ChaCha8Rng::seed_from_u64(seed));
    // Its output starts at zero.
    parameters.iter_mut().enumerate().for_each(|(n, parameter)| *parameter += 0.02 * (n as f32).sin());
    let network = chip_network(&parameters);
    let features = FeatureSpec::default();
    let spec = ResidualSpec { period_us: 1000, gains: GAINS, lambda: 0.5, authority: 60.0, features };
    Residual::new(spec, network).unwrap()
}

fn simulated(architecture: Architecture) -> Simulator {
    let parameters = architecture.initialise(&mut ChaCha8Rng::seed_from_u64(3));
    Simulator { architecture, parameters, noise: 0.1, start_pressure: 5.0, plant: "R20C20".into() }
}

fn architectures() -> [Architecture; 5] {
    [
        Architecture::StateSpace(StateSpaceConfig::for_period(1000, 1)),
        Architecture::StateSpace(StateSpaceConfig { lungs: true, ..StateSpaceConfig::for_period(30_000, 1) }),
        Architecture::Stitched(StitchedConfig::for_period(30_000)),
        Architecture::Hybrid(HybridConfig { ventilators: 2, ..HybridConfig::for_period(1000, 1) }),
        Architecture::Unit(UnitConfig::for_period(1000, 2)),
    ]
}

/// Checks that every operator uses values that are there, and that no name is given twice.
fn check_graph(bytes: &[u8]) -> Model {
    let model = Model::decode(bytes).unwrap();
    assert_eq!(model.opset_import[0].version, OPSET);
    let graph = model.graph.clone().unwrap();
    let mut names: BTreeSet<&str> = graph.input.iter().map(|input| input.name.as_str()).collect();
    names.extend(graph.initializer.iter().map(|constant| constant.name.as_str()));
    for constant in &graph.initializer {
        let size = constant.dims.iter().product::<i64>() as usize;
        assert_eq!(size, constant.float_data.len() + constant.int64_data.len(), "{}", constant.name);
    }
    for node in &graph.node {
        let missing = node.input.iter().find(|input| !names.contains(input.as_str()));
        assert_eq!(missing, None, "{}", node.name);
        assert!(node.output.iter().all(|output| names.insert(output)), "{}", node.name);
    }
    assert!(graph.output.iter().all(|output| names.contains(output.name.as_str())));
    model
}

/// Names and numbers of columns of inputs and outputs; the number of rows is free.
fn ends(model: &Model) -> [Vec<(String, i64)>; 2] {
    let graph = model.graph.clone().unwrap();
    [graph.input, graph.output].map(|values| {
        let of = |value: crate::graph::proto::ValueInfo| {
            let dim = value.kind.unwrap().tensor.unwrap().shape.unwrap().dim;
            let [Some(Size::Name(rows)), Some(Size::Value(columns))] =
                [dim[0].size.clone(), dim[1].size.clone()]
            else {
                panic!("{} is not a matrix with a free number of rows", value.name)
            };
            assert_eq!(rows, "batch");
            (value.name, columns)
        };
        values.into_iter().map(of).collect()
    })
}

fn authors_controller() -> AuthorsController {
    let spec =
        AuthorsSpec { period_us: 1000, gains: GAINS, lambda: 1.0, authority: 50.0, error_spacing_us: 5000 };
    let mut parameters = AuthorsController::initial_parameters(&mut ChaCha8Rng::seed_from_u64(1));
    // Their output starts at zero.
    for (n, parameter) in parameters.iter_mut().enumerate() {
        *parameter += 0.02 * (n as f32).sin();
    }
    AuthorsController::new(spec, &parameters).unwrap()
}

/// Largest difference of a command from the steps of a check, percent.
fn controller_difference(graph: &Interpreter, steps: &[check::ControllerStep]) -> f32 {
    let (mut state, mut worst) = (Matrix::row(&vec![0.0; graph.columns("state")]), 0.0_f32);
    for step in steps {
        let observation = Matrix::row(&step.observation);
        let mut found = graph.run(&[("observation", observation), ("state", state)]);
        state = found.remove("next_state").unwrap();
        if let Some([command, base]) = step.commands {
            for (name, wanted) in [("command", command), ("base", base)] {
                worst = worst.max((found[name].values[0] - wanted).abs());
            }
        }
    }
    worst
}

/// Largest difference of a pressure from the breath of a check, cmH2O.
fn simulator_difference(graph: &Interpreter, breath: &check::SimulatedBreath) -> f32 {
    let (mut state, mut worst) = (Matrix::row(&vec![0.0; graph.columns("state")]), 0.0_f32);
    let blocks = breath.commands.chunks(breath.block_ticks).zip(breath.pressures.chunks(breath.block_ticks));
    for (block, (commands, pressures)) in blocks.enumerate() {
        let inputs = [
            ("commands", Matrix::row(commands)),
            ("start", Matrix::row(&breath.start)),
            ("block", Matrix::row(&[block as f32])),
            ("state", state),
        ];
        let mut found = graph.run(&inputs);
        state = found.remove("next_state").unwrap();
        for (found, wanted) in found["pressures"].values.iter().zip(pressures) {
            worst = worst.max((found - wanted).abs());
        }
    }
    worst
}

/// Checks that a file computes what it should, and that it does not with another weight.
fn check_values(file: &[u8], difference: impl Fn(&Interpreter) -> f32) {
    let graph = Interpreter::new(check_graph(file));
    let exact = difference(&graph);
    assert!(exact <= TOLERANCE, "{exact}");
    // Not only the largest one: that of a physical unit acts in its first ticks, if at all.
    let noticed = (0..5).any(|n| difference(&graph.with_changed_constant(n)) > TOLERANCE);
    assert!(noticed, "changed weights go unnoticed");
}

#[test]
fn a_controller_in_a_file_commands_what_it_commands_here() {
    let ours = learned(1);
    let steps = check::controller(&Controller::Residual(ours.clone()), 1000);
    check_values(&residual(&ours), |graph| controller_difference(graph, &steps));
    let law = authors_controller();
    let steps = check::controller(&law, 1000);
    let graph = Interpreter::new(check_graph(&authors(&law)));
    assert!(controller_difference(&graph, &steps) <= TOLERANCE);
}

#[test]
fn a_simulator_in_a_file_predicts_what_it_predicts_here() {
    for architecture in architectures() {
        let mut simulator = simulated(architecture);
        // Units and ventilators would be alike.
        for (n, parameter) in simulator.parameters.iter_mut().enumerate() {
            *parameter += 0.05 * (n as f32).sin();
        }
        for unit in (0..architecture.members()).map(|unit| Some(unit as u32)).chain([None]) {
            let breath = check::simulator(&simulator, unit);
            let file = super::simulator(&simulator, unit).unwrap();
            check_values(&file, |graph| simulator_difference(graph, &breath));
        }
    }
}

#[test]
fn the_state_of_every_file_has_the_same_place_and_size_before_and_after_the_step() {
    let controllers = [residual(&learned(1)), authors(&authors_controller())];
    for file in controllers {
        let [inputs, outputs] = ends(&check_graph(&file));
        assert_eq!((inputs[0].0.as_str(), inputs[0].1), ("observation", 8));
        assert_eq!((inputs[1].0.as_str(), inputs[1].1), ("state", outputs[1].1));
        assert_eq!([0, 1, 2].map(|n| outputs[n].0.as_str()), ["command", "next_state", "base"]);
    }
    for architecture in architectures() {
        let [inputs, outputs] = ends(&check_graph(&simulator(&simulated(architecture), None).unwrap()));
        assert_eq!(inputs[0].1, outputs[0].1, "a pressure for every command");
        assert_eq!(inputs[0].1 as usize, architecture.timing().block_ticks);
        assert_eq!(inputs[3].1, outputs[1].1, "{architecture:?}");
    }
}

#[test]
fn a_file_contains_the_weights() {
    assert_eq!(residual(&learned(1)), residual(&learned(1)));
    let of = |seed| check_graph(&residual(&learned(seed))).graph.unwrap().initializer;
    assert_ne!(of(1), of(2));
    let weights: Vec<f32> = learned(1).network().hidden_2.parameters().copied().collect();
    let (weights, _) = weights.split_at(32 * 16);
    assert!(of(1).iter().any(|constant| constant.float_data == weights && constant.dims == [16, 32]));
}

#[test]
fn the_steps_of_a_check_learn_are_surprised_and_forget() {
    let law = Controller::Residual(learned(1));
    let steps = check::controller(&law, 1000);
    assert_eq!(steps.iter().filter(|step| step.commands.is_some()).count(), 9 * 700);
    // Again, to see what becomes of each lesson.
    let (mut state, mut lessons) = (law.initial_state(), Vec::new());
    for (number, step) in steps.iter().enumerate() {
        let [pressure, target, pip, peep, applied, time, lesson, rise] = step.observation;
        if step.commands.is_none() {
            let lesson: Lesson = [Adopt, Discard, Forget][lesson as usize];
            lessons.push(law.learn(&mut state, lesson));
            continue;
        }
        let [tick, rise_ticks] = [time, rise].map(|time| (1000.0 * time).round() as u32);
        if tick == 0 {
            law.start_breath(&mut state, applied);
        }
        let seen = Observation { pressure, target, pip, peep, tick, rise_ticks };
        let output = law.step(&mut state, &seen);
        assert_eq!(step.commands.map(|[command, _]| command.to_bits()), Some(output.command.to_bits()));
        law.applied(&mut state, steps[number + 1].observation[4]);
    }
    assert_eq!(lessons, [Adopt, Adopt, Discard, Adopt, Adopt, Adopt, Forget, Adopt, Forget, Adopt]);
}

#[test]
fn a_check_of_a_simulator_has_a_pressure_for_every_command() {
    for architecture in architectures() {
        let breath = check::simulator(&simulated(architecture), Some(0));
        assert_eq!((breath.commands.len(), breath.pressures.len()), (1000, 1000));
        assert!(breath.pressures.iter().all(|pressure| pressure.is_finite()), "{architecture:?}");
    }
}

#[test]
fn a_unit_that_the_simulator_does_not_have_is_refused_and_so_are_two_commands() {
    let units = simulated(Architecture::Unit(UnitConfig::for_period(1000, 2)));
    assert_eq!(simulator(&units, Some(2)), Err(OnnxError::Unit { asked: 2, known: 2 }));
    assert_ne!(simulator(&units, Some(1)).unwrap().len(), 0);
    let two = simulated(Architecture::StateSpace(StateSpaceConfig::for_period(1000, 2)));
    assert_eq!(simulator(&two, None), Err(OnnxError::Channels(2)));
}
