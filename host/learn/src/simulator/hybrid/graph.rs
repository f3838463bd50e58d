//! The hybrid simulator as a graph: a ventilator and a physical lung with the nominal R and C of the input `start`. It is that of a test
//! run that was not recorded, so the network that explains the remainder of a recorded run is not a part of it.

use super::HybridConfig;
use super::lung::{GIVEN, LungEquations, PHYSICS, STATE};
use super::ventilator::{MOST_OPENING, OPENINGS, USUAL_OPENING};
use crate::graph::state::State;
use crate::graph::symbol::{Symbol, Symbols};
use crate::graph::{Builder, Value};
use crate::simulator::block::{Block, commands_seen, known, pressures};
use crate::simulator::leaky::{begin_graph, step_graph};
use crate::simulator::trajectory::Equations;
use crate::simulator::{BreathStart, Timing};

/// Pieces of the state that are the lung's, in the order of its equations.
const PIECES: [&str; STATE] = ["airway pressure", "alveolar pressure"];

/// The graph: the pressures, and the state after the block.
pub(super) fn hybrid(
    graph: &mut Builder,
    block: &Block,
    config: &HybridConfig,
    parameters: &[f32],
) -> (Value, State) {
    let timing = &config.timing;
    let pieces = [
        ("commands", config.history * timing.width()),
        ("states", config.states),
        (PIECES[1], 1),
        (PIECES[0], 1),
        ("pressure", 1),
    ];
    let mut state = State::input(graph, &pieces);
    let [rest, _] = block.rest(graph);
    let seen = commands_seen(graph, &mut state, block, (timing, config.history), &rest);
    let layout = config.layout();
    let openings = openings(graph, &mut state, block, (config, &parameters[layout.ventilator]), &seen);
    let points = lung(graph, &mut state, block, (timing, &parameters[layout.physics]), &openings);
    (pressures(graph, &mut state, block, timing, &points), state)
}

/// The two openings of a block.
fn openings(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    (config, parameters): (&HybridConfig, &[f32]),
    seen: &Value,
) -> [Value; OPENINGS] {
    let ([filters, curves, source, start], decay, own) = config.ventilator_layout();
    let known = known(graph, block, BreathStart::KNOWN);
    begin_graph(graph, state, block, (&start, parameters), &known);
    let filtered = step_graph(graph, state, (&filters, parameters), &parameters[decay..own], seen);
    let width = config.hidden + OPENINGS;
    let own = match block.unit {
        Some(number) => parameters[own + number as usize * width..][..width].to_vec(),
        None => vec![0.0; width],
    };
    let (shifts, stretches) = own.split_at(config.hidden);
    let shifts = graph.row(shifts);
    let curved = graph.layer(&filtered, &curves, parameters);
    let curved = graph.add(&curved, &shifts);
    let curved = graph.op("Softsign", &[&curved]);
    let readout = graph.join(&[&filtered, &curved]);
    let readout = graph.layer(&readout, &source, parameters);
    let readout = graph.shift(&readout, USUAL_OPENING);
    let readout = graph.op("Sigmoid", &[&readout]);
    let most: Vec<f32> = stretches.iter().map(|stretch| MOST_OPENING * stretch.exp()).collect();
    let most = graph.row(&most);
    let openings = graph.mul(&readout, &most);
    [0, 1].map(|n| graph.columns(&openings, &[n]))
}

/// The lung of a breath: the airway pressure at each point of a block, from its openings.
fn lung(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    (timing, physics): (&Timing, &[f32]),
    openings: &[Value; OPENINGS],
) -> Vec<Value> {
    let symbols = Symbols::new(graph);
    let known = [block.pressure(), block.plateau(), block.lung()[0], block.lung()[1]];
    let given: [_; GIVEN] = std::array::from_fn(|n| match n.checked_sub(PHYSICS) {
        None => symbols.constant(physics[n]),
        // A lung that was not recorded has no deviations.
        Some(n) => known.get(n).map_or_else(|| symbols.constant(0.0), |value| symbols.of(value)),
    });
    let (numbers, first) = LungEquations::new(timing).begin(given);
    let (numbers, first) = (numbers.map(Symbol::value), first.map(Symbol::value));
    for (piece, value) in PIECES.iter().zip(&first) {
        state.set_where(graph, &block.begins, piece, value);
    }
    let symbols = Symbols::new(graph);
    let numbers = numbers.each_ref().map(|value| symbols.of(value));
    let openings = openings.each_ref().map(|value| symbols.of(value));
    let mut now = PIECES.map(|piece| symbols.of(&state.get(piece)));
    let mut points = Vec::new();
    for _ in 0..timing.points {
        now = LungEquations::tick(numbers, now, openings);
        points.push(now[0].value());
    }
    for (piece, symbol) in PIECES.iter().zip(now) {
        state.set(piece, symbol.value());
    }
    points
}
