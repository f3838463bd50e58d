//! The controller of the paper's authors as a graph, with the same inputs and outputs as ours.

use shared::control::features::ERROR_SCALE;

use super::controller::{Seen, correction, finish, pid};
use crate::controller::architecture::Trainable;
use crate::controller::authors::AuthorsController;
use crate::controller::authors::averages::ERRORS;
use crate::controller::authors::convolution::{KERNEL, POSITIONS, layout};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use ventilator::law::Law;

/// The file of a controller of the authors' architecture.
pub fn authors(controller: &AuthorsController) -> Vec<u8> {
    let period_us = controller.spec().period_us;
    let mut graph = Builder::new("controller");
    let seen = Seen::input(&mut graph, period_us);
    let length = (ERRORS - 1) * controller.spacing() + 1;
    let pieces =
        [("errors", length), ("integral", 1), ("derivative", 1), ("pressure", 1), ("has pressure", 1)];
    let mut state = State::input(&mut graph, &pieces);
    for (piece, width) in pieces.iter().filter(|(piece, _)| *piece != "pressure") {
        let zeros = graph.row(&vec![0.0; *width]);
        state.set_where(&mut graph, &seen.starts, piece, &zeros);
    }
    let difference = graph.sub(&seen.target, &seen.pressure);
    let scale = graph.number(ERROR_SCALE);
    let error = graph.div(&difference, &scale);
    let errors = graph.pushed(&error, &state.get("errors"), length);
    state.set_where(&mut graph, &seen.ticks, "errors", &errors);
    let taps: Vec<usize> = (0..ERRORS).map(|count| count * controller.spacing()).collect();
    let newest_first = graph.columns(&errors, &taps);
    let averages = averages(&mut graph, &newest_first);
    let output = network(&mut graph, &averages, &controller.parameters());
    let spec = controller.spec();
    let residual = correction(&mut graph, &output, (spec.lambda, spec.authority));
    let commands = pid(&mut graph, &mut state, &seen, controller.pid(), &residual);
    finish(graph, &state, period_us, &commands)
}

/// Running averages of the errors, that over all of them first.
fn averages(graph: &mut Builder, newest_first: &Value) -> Value {
    let row = |average: usize| {
        let count = ERRORS - average;
        (0..ERRORS).map(move |error| if error < count { 1.0 / count as f32 } else { 0.0 })
    };
    let weights: Vec<f32> = (0..ERRORS).flat_map(row).collect();
    graph.dense(newest_first, &weights, &[0.0; ERRORS])
}

/// The convolution, the rectifier and the dense output.
fn network(graph: &mut Builder, inputs: &Value, parameters: &[f32]) -> Value {
    let [kernel, output] = layout();
    let positions: Vec<Value> = (0..POSITIONS)
        .map(|first| {
            let window: Vec<usize> = (first..first + KERNEL).collect();
            let window = graph.columns(inputs, &window);
            graph.layer(&window, &kernel, parameters)
        })
        .collect();
    let channels = graph.join(&positions.iter().collect::<Vec<_>>());
    let channels = graph.op("Relu", &[&channels]);
    graph.layer(&channels, &output, parameters)
}
