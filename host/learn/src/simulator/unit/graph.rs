//! The physical simulator of a unit as a graph: valve, circuit and lung by their equations, with the unit's numbers as constants.

use super::lung::{
    CIRCUIT, CLOSING, COMPLIANCE, EXPIRATORY_LINEAR, LEAK, LEAK_PARTS, LEAST_DRIVE, ML_PER_L, ORIFICE,
    OUTWARD, RESISTANCE, SENSOR, TURBULENCE, left_in_lung,
};
use super::valve::{DEAD_TIME, EXPONENT, FULL, FULL_FLOW, LAG, LEAST, PLAY, SUPPLY, ZONE};
use super::{PER_UNIT, UnitConfig, VALVE};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use crate::simulator::COMMAND_SCALE;
use crate::simulator::block::{Block, commands_seen, pressures};
use crate::simulator::branch::conductance_graph;

/// The numbers of a unit.
struct Numbers<'a> {
    logarithms: &'a [f32],
    tick_ms: f32,
}

impl Numbers<'_> {
    fn valve(&self, number: usize) -> f32 {
        self.logarithms[number].exp()
    }

    fn lung(&self, number: usize) -> f32 {
        self.logarithms[VALVE + number].exp()
    }

    /// Share of the way that is left after a tick, with this lag in ms.
    fn left(&self, lag: f32) -> f32 {
        (-self.tick_ms / lag).exp()
    }

    /// Effect of 1 L/s for a tick, mL.
    fn volume(&self) -> f32 {
        ML_PER_L * 1e-3 * self.tick_ms
    }
}

/// The graph: the pressures, and the state after the tick.
pub(super) fn unit(
    graph: &mut Builder,
    block: &Block,
    config: &UnitConfig,
    parameters: &[f32],
) -> (Value, State) {
    let numbers = Numbers {
        logarithms: &parameters[block.unit.unwrap_or(0) as usize * PER_UNIT..][..PER_UNIT],
        tick_ms: 1e3 * config.timing.block_s(),
    };
    let dead_time = numbers.valve(DEAD_TIME) / numbers.tick_ms;
    let history = dead_time as usize + 2;
    let pieces = [
        ("commands", history),
        ("actuator", 1),
        ("stem", 1),
        ("opening", 1),
        ("airway pressure", 1),
        ("alveolar pressure", 1),
        ("pressure", 1),
    ];
    let mut state = State::input(graph, &pieces);
    let [rest, _] = block.rest(graph);
    let seen = commands_seen(graph, &mut state, block, (&config.timing, history), &rest);
    let percent = graph.scale(&seen, COMMAND_SCALE);
    let [newer, older] = [history - 2, history - 1].map(|age| graph.columns(&percent, &[age]));
    let part = graph.number(dead_time - dead_time.floor());
    let delayed = graph.towards(&newer, &older, &part);
    begin(graph, &mut state, block, config, &numbers);
    let opening = valve(graph, &mut state, &numbers, &delayed);
    let sensed = lung(graph, &mut state, block, &numbers, &opening);
    (pressures(graph, &mut state, block, &config.timing, &[sensed]), state)
}

/// Starts a breath: the valve at rest, the expiratory valve open, and in the lung what the expiration has left.
fn begin(graph: &mut Builder, state: &mut State, block: &Block, config: &UnitConfig, numbers: &Numbers<'_>) {
    let [rest, _] = block.rest(graph);
    let rest = graph.scale(&rest, COMMAND_SCALE);
    let open = graph.number(1.0);
    let times = [config.inspiration_ms, config.expiration_ms].map(|ms| ms as f32 * 1e-3);
    let lung = [RESISTANCE, COMPLIANCE, OUTWARD].map(|number| numbers.lung(number));
    let above = graph.sub(block.plateau(), block.peep());
    let left = graph.scale(&above, left_in_lung(times, lung));
    let alveolar = graph.add(block.peep(), &left);
    for (piece, value) in [
        ("actuator", &rest),
        ("stem", &rest),
        ("opening", &open),
        ("airway pressure", block.pressure()),
        ("alveolar pressure", &alveolar),
        ("pressure", block.pressure()),
    ] {
        state.set_where(graph, &block.begins, piece, value);
    }
}

/// Share of the valve's full flow: lag, play, dead zone and curve of a delayed command in percent.
fn valve(graph: &mut Builder, state: &mut State, numbers: &Numbers<'_>, delayed: &Value) -> Value {
    let share = graph.number(1.0 - numbers.left(numbers.valve(LAG)));
    let actuator = graph.towards(&state.get("actuator"), delayed, &share);
    let play = graph.number(numbers.valve(PLAY));
    let room = graph.op("Min", &[&play, &actuator]);
    let hangs = graph.add(&actuator, &room);
    let stem = graph.op("Min", &[&state.get("stem"), &hangs]);
    let stem = graph.op("Max", &[&stem, &actuator]);
    state.set("actuator", actuator);
    state.set("stem", stem.clone());
    let zone = numbers.valve(ZONE);
    let travel = graph.shift(&stem, -zone);
    let width = graph.number(FULL - zone);
    let travel = graph.div(&travel, &width);
    let (least, exponent) = (graph.number(LEAST), graph.number(numbers.valve(EXPONENT)));
    let flows = graph.less(&least, &travel);
    let sound = graph.op("Max", &[&travel, &least]);
    let share = graph.op("Pow", &[&sound, &exponent]);
    let closed = graph.not(&flows);
    graph.cleared(&closed, &share)
}

/// One implicit step of circuit and lung; the sensed pressure after it.
fn lung(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    numbers: &Numbers<'_>,
    opening: &Value,
) -> Value {
    let expiratory = graph.scale(&state.get("opening"), numbers.left(numbers.lung(CLOSING)));
    state.set("opening", expiratory.clone());
    let (p, a) = (state.get("airway pressure"), state.get("alveolar pressure"));
    let rise = numbers.volume() / numbers.lung(COMPLIANCE);
    let resistance = numbers.lung(RESISTANCE);
    let drop = graph.sub(&p, &a);
    let into = conductance(graph, (resistance + rise, resistance * numbers.lung(TURBULENCE)), &drop);
    let above = graph.sub(&p, block.peep());
    let orifice = numbers.lung(ORIFICE);
    let out = conductance(graph, (EXPIRATORY_LINEAR, 1.0 / (orifice * orifice)), &above);
    let zero = graph.number(0.0);
    let flows = graph.op("Greater", &[&above, &zero]);
    let out = graph.choose(&flows, &out, &zero);
    let out = graph.mul(&expiratory, &out);
    let leak = conductance(graph, LEAK_PARTS, &p);
    let leak = graph.scale(&leak, numbers.lung(LEAK));
    let keep = graph.number(numbers.lung(CIRCUIT) / numbers.volume());
    let inflow = inflow(graph, numbers, opening, &p);
    let kept = graph.mul(&keep, &p);
    let expired = graph.mul(&out, block.peep());
    let back = graph.mul(&into, &a);
    let sum = graph.sum_of(&[&kept, &inflow, &expired, &back]);
    let total = graph.sum_of(&[&keep, &into, &out, &leak]);
    let next = graph.div(&sum, &total);
    let difference = graph.sub(&next, &a);
    let risen = graph.scale(&into, rise);
    let risen = graph.mul(&risen, &difference);
    let alveolar = graph.add(&a, &risen);
    state.set("alveolar pressure", alveolar);
    state.set("airway pressure", next.clone());
    let sensor = graph.number(1.0 - numbers.left(numbers.lung(SENSOR)));
    graph.towards(&state.get("pressure"), &next, &sensor)
}

/// Flow of the valve against a pressure, L/s.
fn inflow(graph: &mut Builder, numbers: &Numbers<'_>, opening: &Value, pressure: &Value) -> Value {
    let supply = graph.number(numbers.valve(SUPPLY));
    let share = graph.div(pressure, &supply);
    let one = graph.number(1.0);
    let rest = graph.sub(&one, &share);
    let least = graph.number(LEAST_DRIVE);
    let rest = graph.op("Max", &[&rest, &least]);
    let drive = graph.op("Sqrt", &[&rest]);
    let flow = graph.scale(opening, numbers.valve(FULL_FLOW));
    graph.mul(&flow, &drive)
}

/// Conductance of a parabolic resistor at a pressure difference.
fn conductance(graph: &mut Builder, (linear, square): (f32, f32), difference: &Value) -> Value {
    let size = graph.op("Abs", &[difference]);
    let [linear, linear_square, four_square] =
        [linear, linear * linear, 4.0 * square].map(|number| graph.number(number));
    conductance_graph(graph, [&linear, &linear_square, &four_square], &size)
}
