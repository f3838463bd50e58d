//! What the graphs of all simulators share: the inputs of a block, the commands that a step sees, and the pressures of its ticks.

use super::{BreathStart, COMMAND_SCALE, PRESSURE_SCALE, Timing, USUAL_PEEP};
use crate::graph::state::State;
use crate::graph::{Builder, Value};

/// Columns of the input `start`, in their order: the state before the breath, and the lung of a simulator of many lungs.
pub const START: [&str; 7] = [
    "pressure before the breath, cmH2O",
    "PEEP, cmH2O",
    "pressure at the end of the last inspiration, cmH2O",
    "command before the breath, percent",
    "command at the end of the last inspiration, percent",
    "resistance, cmH2O/(L/s)",
    "compliance, mL/cmH2O",
];
/// Names of the inputs before the state.
const INPUTS: [&str; 3] = ["commands", "start", "block"];
/// Inputs of a block.
pub struct Block {
    /// Unit of a simulator of several; without one a physical simulator's first, and for a hybrid a ventilator of none of the
    /// recorded ones.
    pub unit: Option<u32>,
    /// Whether it is the first one of a breath.
    pub begins: Value,
    /// Commands of its ticks, percent.
    pub commands: Value,
    /// The columns of `start`.
    pub start: [Value; START.len()],
}

impl Block {
    pub fn input(graph: &mut Builder, timing: &Timing, unit: Option<u32>) -> Self {
        let commands = graph.input(INPUTS[0], timing.block_ticks, "commands of the block's ticks, percent");
        let start = graph.input(INPUTS[1], START.len(), &START.join("; "));
        let block = graph.input(INPUTS[2], 1, "number of the block in its breath, from 0");
        let Ok(start) = <[Value; START.len()]>::try_from(graph.split(&start, &[1; START.len()])) else {
            unreachable!("a split gives as many pieces as asked for")
        };
        let half = graph.number(0.5);
        Self { unit, begins: graph.less(&block, &half), commands, start }
    }

    /// The pressure before the breath.
    pub fn pressure(&self) -> &Value {
        &self.start[0]
    }

    /// PEEP.
    pub fn peep(&self) -> &Value {
        &self.start[1]
    }

    /// The pressure at the end of the last inspiration.
    pub fn plateau(&self) -> &Value {
        &self.start[2]
    }

    /// The commands before the breath and at the end of the last inspiration, scaled.
    pub fn rest(&self, graph: &mut Builder) -> [Value; 2] {
        let scale = graph.number(COMMAND_SCALE);
        [&self.start[3], &self.start[4]].map(|percent| graph.div(percent, &scale))
    }

    /// Resistance and compliance.
    pub fn lung(&self) -> [&Value; 2] {
        [&self.start[5], &self.start[6]]
    }
}

/// The scaled commands that a step of a simulator sees, newest first: of `history` blocks up to the newest one that may act in it. The
/// state has a piece `commands` for them. Before the breath they were `rest`.
pub fn commands_seen(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    (timing, history): (&Timing, usize),
    rest: &Value,
) -> Value {
    let width = history * timing.width();
    let ones = graph.row(&vec![1.0; width]);
    let rest = graph.mul(&ones, rest);
    state.set_where(graph, &block.begins, "commands", &rest);
    let share = |part: usize, tick: usize| {
        if timing.part(tick) == part { 1.0 / (COMMAND_SCALE * timing.part_ticks(part) as f32) } else { 0.0 }
    };
    let weights: Vec<f32> = (0..timing.parts)
        .flat_map(|part| (0..timing.block_ticks).map(move |tick| share(part, tick)))
        .collect();
    let means = graph.dense(&block.commands, &weights, &vec![0.0; timing.parts]);
    let before = state.get("commands");
    let kept: Vec<usize> = (0..width - timing.width()).collect();
    let after = if kept.is_empty() {
        means
    } else {
        let kept = graph.columns(&before, &kept);
        graph.join(&[&means, &kept])
    };
    state.set("commands", after.clone());
    if timing.lag() == 0 { after } else { before }
}

/// The pressure after each tick of a block, from those at its points, cmH2O; the state has a piece `pressure` for the last of them.
pub fn pressures(
    graph: &mut Builder,
    state: &mut State,
    block: &Block,
    timing: &Timing,
    points: &[Value],
) -> Value {
    state.set_where(graph, &block.begins, "pressure", block.pressure());
    let first = state.get("pressure");
    let all: Vec<&Value> = [&first].into_iter().chain(points).collect();
    let all = graph.join(&all);
    let row = |tick: usize| {
        // After the last tick, the pressure is that of the last point.
        let weights = timing.interpolation(tick);
        (0..=timing.points).map(move |point| weights[point])
    };
    let weights: Vec<f32> = (1..=timing.block_ticks).flat_map(row).collect();
    if let Some(last) = points.last() {
        state.set("pressure", last.clone());
    }
    graph.dense(&all, &weights, &vec![0.0; timing.block_ticks])
}

/// The first `count` of the quantities known at the start of a breath, scaled as for [`BreathStart::known`].
pub fn known(graph: &mut Builder, block: &Block, count: usize) -> Value {
    let (mean, scale) = PRESSURE_SCALE;
    let one = graph.number(scale);
    let pressure = graph.shift(block.pressure(), -USUAL_PEEP);
    let plateau = graph.shift(block.plateau(), -mean);
    let [pressure, plateau] = [pressure, plateau].map(|pressure| graph.div(&pressure, &one));
    let [rest, last] = block.rest(graph);
    let all: [&Value; BreathStart::KNOWN] = [&pressure, &plateau, &rest, &last];
    graph.join(&all[..count])
}
