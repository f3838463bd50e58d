//! The hybrid simulator as a graph: a ventilator and a physical lung with the nominal R and C of the input `start`. It is that of a test
//! run that was not recorded, so the network that explains the remainder of a recorded run is not a part of it.

use super::HybridConfig;
use super::lung::{ML_PER_L, NOMINAL, Physics, ROUNDING};
use super::ventilator::{MOST_OPENING, OPENINGS, USUAL_OPENING};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use crate::simulator::BreathStart;
use crate::simulator::block::{Block, commands_seen, known, pressures};
use crate::simulator::branch::conductance_graph;
use crate::simulator::leaky::{begin_graph, step_graph};

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
        ("alveolar pressure", 1),
        ("airway pressure", 1),
        ("pressure", 1),
    ];
    let mut state = State::input(graph, &pieces);
    let [rest, _] = block.rest(graph);
    let seen = commands_seen(graph, &mut state, block, (timing, config.history), &rest);
    let layout = config.layout();
    let openings = openings(graph, &mut state, block, (config, &parameters[layout.ventilator]), &seen);
    let physics = Physics::new(timing, &parameters[layout.physics]);
    let lung = Lung::of(graph, block, &physics);
    begin_lung(graph, &mut state, block, physics.left);
    let points: Vec<Value> = (0..timing.points).map(|_| lung.step(graph, &mut state, &openings)).collect();
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

/// The lung of a breath.
struct Lung {
    /// R1, its square, and four times R2.
    linear: Value,
    linear_square: Value,
    square: Value,
    rise: Value,
    keep: Value,
    supply: Value,
}

impl Lung {
    fn of(graph: &mut Builder, block: &Block, physics: &Physics) -> Self {
        let step = ML_PER_L * physics.step_s;
        let [resistance, compliance] = block.lung();
        let nominal = graph.number(NOMINAL);
        let resistance = graph.div(resistance, &nominal);
        let linear = graph.scale(&resistance, physics.linear.exp());
        let square = graph.scale(&resistance, 4.0 * physics.square.exp());
        let compliance = graph.scale(compliance, physics.compliance.exp());
        let step_value = graph.number(step);
        Self {
            linear_square: graph.mul(&linear, &linear),
            linear,
            square,
            rise: graph.div(&step_value, &compliance),
            keep: graph.number(physics.circuit.exp() / step),
            supply: graph.number(physics.supply.exp()),
        }
    }

    /// One implicit step with these openings; the airway pressure after it.
    fn step(&self, graph: &mut Builder, state: &mut State, [inlet, outlet]: &[Value; OPENINGS]) -> Value {
        let (p, a) = (state.get("airway pressure"), state.get("alveolar pressure"));
        let drop = graph.sub(&p, &a);
        let lung = self.conductance(graph, &drop);
        let from_supply = graph.sub(&self.supply, &p);
        let into = orifice(graph, &from_supply);
        let into = graph.mul(inlet, &into);
        let out = orifice(graph, &p);
        let out = graph.mul(outlet, &out);
        let kept = graph.mul(&self.keep, &p);
        let supplied = graph.mul(&into, &self.supply);
        let back = graph.mul(&lung, &a);
        let flows = graph.sum_of(&[&kept, &supplied, &back]);
        let conductances = graph.sum_of(&[&self.keep, &into, &out, &lung]);
        let next = graph.div(&flows, &conductances);
        let difference = graph.sub(&next, &a);
        let rise = graph.mul(&self.rise, &lung);
        let rise = graph.mul(&rise, &difference);
        let alveolar = graph.add(&a, &rise);
        state.set("alveolar pressure", alveolar);
        state.set("airway pressure", next.clone());
        next
    }

    /// Conductance of the resistor at a pressure drop, smoothed around zero.
    fn conductance(&self, graph: &mut Builder, drop: &Value) -> Value {
        let size = graph.mul(drop, drop);
        let size = graph.shift(&size, ROUNDING * ROUNDING);
        let size = graph.op("Sqrt", &[&size]);
        conductance_graph(graph, [&self.linear, &self.linear_square, &self.square], &size)
    }
}

/// Starts a breath: the share `left` of the last plateau is still in the lung.
fn begin_lung(graph: &mut Builder, state: &mut State, block: &Block, left: f32) {
    let fall = graph.sub(block.plateau(), block.pressure());
    let left = graph.scale(&fall, left);
    let alveolar = graph.add(block.pressure(), &left);
    state.set_where(graph, &block.begins, "alveolar pressure", &alveolar);
    state.set_where(graph, &block.begins, "airway pressure", block.pressure());
}

/// Conductance of a unit opening under a pressure drop.
fn orifice(graph: &mut Builder, drop: &Value) -> Value {
    let square = graph.mul(drop, drop);
    let square = graph.shift(&square, 1.0);
    let root = graph.op("Sqrt", &[&square]);
    let root = graph.op("Sqrt", &[&root]);
    graph.op("Reciprocal", &[&root])
}
