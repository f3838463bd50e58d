//! The physical simulator of a unit as a graph: its equations, with the unit's numbers as constants.

use super::equations::{SENSED, STATE, UnitEquations};
use super::valve::{DEAD_TIME, PLAY};
use super::{PER_UNIT, UnitConfig};
use crate::graph::state::State;
use crate::graph::symbol::{Symbol, Symbols};
use crate::graph::{Builder, Value};
use crate::simulator::COMMAND_SCALE;
use crate::simulator::block::{Block, commands_seen, pressures};
use crate::simulator::trajectory::Equations;
use engine::Lane;
use engine::number::Number;

/// Pieces of the state, in the order of the equations'.
const PIECES: [&str; STATE] =
    ["actuator", "stem", "opening", "airway pressure", "alveolar pressure", "pressure"];

/// The graph: the pressures, and the state after the tick.
pub(super) fn unit(
    graph: &mut Builder,
    block: &Block,
    config: &UnitConfig,
    parameters: &[f32],
) -> (Value, State) {
    let equations = UnitEquations::new(config);
    let own = &parameters[block.unit.unwrap_or(0) as usize * PER_UNIT..];
    let unit: [Lane; PER_UNIT] = std::array::from_fn(|n| Lane::splat(own[n]).exp());
    let history = equations.dead_time(Lane::splat(own[DEAD_TIME]))[0] as usize + 2;
    let mut pieces = vec![("commands", history)];
    pieces.extend(PIECES.map(|piece| (piece, 1)));
    let mut state = State::input(graph, &pieces);
    let [rest, before] = block.rest(graph);
    let seen = commands_seen(graph, &mut state, block, (&config.timing, history), &rest);
    let percent = graph.scale(&seen, COMMAND_SCALE);
    let [newer, older] = [history - 2, history - 1].map(|age| graph.columns(&percent, &[age]));
    let [rest, before] = [rest, before].map(|scaled| graph.scale(&scaled, COMMAND_SCALE));

    let symbols = Symbols::new(graph);
    let known =
        [block.pressure(), block.peep(), block.plateau(), &rest, &before].map(|value| symbols.of(value));
    let left = UnitEquations::left(&unit, config.phases().map(Lane::splat))[0];
    let unknown = [left, unit[PLAY][0]].map(|number| symbols.constant(number));
    let first = UnitEquations::start(unknown, known).map(Symbol::value);
    for (piece, value) in PIECES.iter().zip(&first) {
        state.set_where(graph, &block.begins, piece, value);
    }

    let symbols = Symbols::new(graph);
    let numbers = equations.numbers(unit).map(|number| symbols.constant(number[0]));
    let [newer, older, peep] = [&newer, &older, block.peep()].map(|value| symbols.of(value));
    let before = PIECES.map(|piece| symbols.of(&state.get(piece)));
    let inputs = [newer, older, peep, symbols.constant(0.0)];
    let after = UnitEquations::tick(numbers, before, inputs).map(Symbol::value);
    // The sensed pressure is set with those of the ticks.
    for (piece, value) in PIECES.iter().zip(&after[..SENSED]) {
        state.set(piece, value.clone());
    }
    (pressures(graph, &mut state, block, &config.timing, &after[SENSED..]), state)
}
