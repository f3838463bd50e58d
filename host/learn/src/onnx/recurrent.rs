//! The network of leaky states as part of a graph, and with it the state-space simulator.

use super::graph::{Builder, Value};
use super::simulator::{Block, commands_seen, pressures};
use super::state::State;
use crate::simulator::leaky::sigmoid;
use crate::simulator::recurrent::RecurrentShape;
use crate::simulator::state_space::StateSpaceConfig;
use crate::simulator::{BreathStart, PRESSURE_SCALE, USUAL_LUNG, USUAL_PEEP};
use engine::dense::DenseLayer;

/// The graph of a state-space simulator: the pressures, and the state after the block.
pub(super) fn state_space(
    graph: &mut Builder,
    block: &Block,
    config: &StateSpaceConfig,
    parameters: &[f32],
) -> (Value, State) {
    let (shape, timing) = (config.shape(), &config.timing);
    let pieces = [("commands", config.history * timing.width()), ("states", config.states), ("pressure", 1)];
    let mut state = State::input(graph, &pieces);
    let [rest, _] = block.rest(graph);
    let seen = commands_seen(graph, &mut state, block, (timing, config.history), &rest);
    let known = known(graph, block, shape.known);
    let constants = (shape.constants > 0).then(|| lung(graph, block));
    let outputs =
        network(graph, &mut state, block, (&shape, parameters), &known, (&seen, constants.as_ref()));
    let (mean, scale) = PRESSURE_SCALE;
    let points = graph.scale(&outputs, scale);
    let points = graph.shift(&points, mean);
    let points = graph.split(&points, &vec![1; timing.points]);
    (pressures(graph, &mut state, block, timing, &points), state)
}

/// The first `count` of the quantities known at the start of a breath, scaled as for [`BreathStart::known`].
pub(super) fn known(graph: &mut Builder, block: &Block, count: usize) -> Value {
    let (mean, scale) = PRESSURE_SCALE;
    let one = graph.number(scale);
    let pressure = graph.shift(block.pressure(), -USUAL_PEEP);
    let plateau = graph.shift(block.plateau(), -mean);
    let [pressure, plateau] = [pressure, plateau].map(|pressure| graph.div(&pressure, &one));
    let [rest, last] = block.rest(graph);
    let all: [&Value; BreathStart::KNOWN] = [&pressure, &plateau, &rest, &last];
    graph.join(&all[..count])
}

/// The inputs that describe the lung.
fn lung(graph: &mut Builder, block: &Block) -> Value {
    let usual = [USUAL_LUNG.resistance, USUAL_LUNG.compliance];
    let [resistance, compliance] = [0, 1].map(|n| {
        let usual = graph.number(usual[n]);
        let ratio = graph.div(block.lung()[n], &usual);
        graph.op("Log", &[&ratio])
    });
    graph.join(&[&resistance, &compliance])
}

/// One step of the network; the state has a piece `states`.
fn network(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    (shape, parameters): (&RecurrentShape, &[f32]),
    known: &Value,
    (seen, constants): (&Value, Option<&Value>),
) -> Value {
    let ([hidden, drive, readout, start], decay, end) = shape.layout();
    begin(graph, state, block, (&start, parameters), known);
    let before = state.get("states");
    let inputs: Vec<&Value> = [&before, seen].into_iter().chain(constants).collect();
    let inputs = graph.join(&inputs);
    let z = graph.layer(&inputs, &hidden, parameters);
    let z = graph.op("Softsign", &[&z]);
    let drives = graph.join(&[&z, seen]);
    let after = leaky(graph, state, (&drive, parameters), &parameters[decay..end], &drives);
    let readouts = graph.join(&[&after, &z]);
    graph.layer(&readouts, &readout, parameters)
}

/// Sets the leaky states at the start of a breath.
pub(super) fn begin(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    (start, parameters): (&DenseLayer, &[f32]),
    known: &Value,
) {
    let begun = graph.layer(known, start, parameters);
    state.set_where(graph, &block.begins, "states", &begun);
}

/// Leaky states after a block, driven by these inputs.
pub(super) fn leaky(
    graph: &mut Builder,
    state: &mut State,
    (drive, parameters): (&DenseLayer, &[f32]),
    decays: &[f32],
    inputs: &Value,
) -> Value {
    let keep: Vec<f32> = decays.iter().map(|decay| sigmoid(*decay)).collect();
    let rest: Vec<f32> = keep.iter().map(|keep| 1.0 - keep).collect();
    let (keep, rest) = (graph.row(&keep), graph.row(&rest));
    let driven = graph.layer(inputs, drive, parameters);
    let kept = graph.mul(&keep, &state.get("states"));
    let driven = graph.mul(&rest, &driven);
    let after = graph.add(&kept, &driven);
    state.set("states", after.clone());
    after
}
