//! The simulator of the paper's authors as a graph. All of its networks are computed in each step, and the one whose turn it is counts.

use super::graph::{Builder, Value};
use super::simulator::{Block, commands_seen, pressures};
use super::state::State;
use crate::simulator::PRESSURE_SCALE;
use crate::simulator::stitched::{BOUNDARIES, COMMANDS, PRESSURES, PRESSURES_SHARED, StitchedConfig};
use engine::dense::DenseLayer;

/// The graph: the pressures, and the state after the step.
pub(super) fn stitched(
    graph: &mut Builder,
    block: &Block,
    config: &StitchedConfig,
    parameters: &[f32],
) -> (Value, State) {
    let pieces = [("commands", COMMANDS), ("pressures", PRESSURES), ("pressure", 1), ("step", 1)];
    let mut state = State::input(graph, &pieces);
    begin(graph, &mut state, block);
    // The networks know nothing of the command before the breath.
    let none = graph.number(0.0);
    let commands = commands_seen(graph, &mut state, block, (&config.timing, COMMANDS), &none);
    let past = state.get("pressures");
    let next = networks(graph, &state, &commands, &past, parameters);
    let past = graph.pushed(&next, &past, PRESSURES);
    state.set("pressures", past);
    let step = graph.shift(&state.get("step"), 1.0);
    state.set("step", step);
    let (mean, scale) = PRESSURE_SCALE;
    let point = graph.scale(&next, scale);
    let point = graph.shift(&point, mean);
    (pressures(graph, &mut state, block, &config.timing, &[point]), state)
}

/// Starts a breath: one pressure is known, and no step has been run.
fn begin(graph: &mut Builder, state: &mut State, block: &Block) {
    let (mean, scale) = PRESSURE_SCALE;
    let pressure = graph.shift(block.pressure(), -mean);
    let one = graph.number(scale);
    let pressure = graph.div(&pressure, &one);
    let missing = graph.row(&[0.0; PRESSURES - 1]);
    let counted = graph.scale(&pressure, 0.0);
    let missing = graph.add(&missing, &counted);
    let known = graph.join(&[&pressure, &missing]);
    state.set_where(graph, &block.begins, "pressures", &known);
    let step = graph.cleared(&block.begins, &state.get("step"));
    state.set("step", step);
}

/// The next scaled pressure, from the network of the step.
fn networks(graph: &mut Builder, state: &State, commands: &Value, past: &Value, parameters: &[f32]) -> Value {
    let (layers, _) = StitchedConfig::layout();
    let (boundaries, shared) = layers.split_at(2 * BOUNDARIES);
    let known: Vec<f32> = (0..PRESSURES).map(|age| if age < PRESSURES_SHARED { 1.0 } else { 0.0 }).collect();
    let known = graph.row(&known);
    let few = graph.mul(past, &known);
    let (inputs, few) = (graph.join(&[commands, past]), graph.join(&[commands, &few]));
    let mut next = stack(graph, few, shared, "Selu", parameters);
    for (number, layers) in boundaries.chunks(2).enumerate().rev() {
        let own = stack(graph, inputs.clone(), layers, "Tanh", parameters);
        let bound = graph.number(number as f32 + 0.5);
        let turn = graph.less(&state.get("step"), &bound);
        next = graph.choose(&turn, &own, &next);
    }
    next
}

/// Layers with an activation between them.
fn stack(
    graph: &mut Builder,
    inputs: Value,
    layers: &[DenseLayer],
    activation: &str,
    parameters: &[f32],
) -> Value {
    let mut value = inputs;
    for (n, layer) in layers.iter().enumerate() {
        value = graph.layer(&value, layer, parameters);
        if n + 1 < layers.len() {
            value = graph.op(activation, &[&value]);
        }
    }
    value
}
