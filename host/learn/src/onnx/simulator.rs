//! A learned simulator as a graph: one block of control ticks, with the state of the simulator as an input and an output.
//!
//! A block begins with the state after the last one and takes the commands of its ticks; it gives the pressure after each of them. At
//! the first block of a breath, where the time is zero, the state comes from the input `start`.

use super::graph::{Builder, Value};
use super::state::State;
use super::{hybrid, recurrent, stitched, unit};
use crate::simulator::model::{Architecture, Simulator};
use crate::simulator::{COMMAND_SCALE, Timing};
use thiserror::Error;

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
/// Name of the first output.
const PRESSURES: &str = "pressures";

/// Why a simulator cannot be exported.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OnnxError {
    /// It takes more than one command.
    #[error(
        "the simulator takes {0} commands in each tick, but only those with one can be exported: fit it to a recording of one valve"
    )]
    Channels(usize),
    /// There is no such unit.
    #[error("the simulator has no unit {asked}: it has {known}, numbered from 0")]
    Unit {
        /// The unit asked for.
        asked: u32,
        /// Number of its units.
        known: usize,
    },
}

/// Inputs of a block.
pub(super) struct Block {
    /// Whether it is the first one of a breath.
    pub(super) begins: Value,
    /// Commands of its ticks, percent.
    pub(super) commands: Value,
    /// The columns of `start`.
    pub(super) start: [Value; START.len()],
}

impl Block {
    fn input(graph: &mut Builder, timing: &Timing) -> Self {
        let commands = graph.input(INPUTS[0], timing.block_ticks, "commands of the block's ticks, percent");
        let start = graph.input(INPUTS[1], START.len(), &START.join("; "));
        let block = graph.input(INPUTS[2], 1, "number of the block in its breath, from 0");
        let Ok(start) = <[Value; START.len()]>::try_from(graph.split(&start, &[1; START.len()])) else {
            unreachable!("a split gives as many pieces as asked for")
        };
        let half = graph.number(0.5);
        Self { begins: graph.less(&block, &half), commands, start }
    }

    /// The pressure before the breath.
    pub(super) fn pressure(&self) -> &Value {
        &self.start[0]
    }

    /// PEEP.
    pub(super) fn peep(&self) -> &Value {
        &self.start[1]
    }

    /// The pressure at the end of the last inspiration.
    pub(super) fn plateau(&self) -> &Value {
        &self.start[2]
    }

    /// The commands before the breath and at the end of the last inspiration, scaled.
    pub(super) fn rest(&self, graph: &mut Builder) -> [Value; 2] {
        let scale = graph.number(COMMAND_SCALE);
        [&self.start[3], &self.start[4]].map(|percent| graph.div(percent, &scale))
    }

    /// Resistance and compliance.
    pub(super) fn lung(&self) -> [&Value; 2] {
        [&self.start[5], &self.start[6]]
    }
}

/// The scaled commands that a step of a simulator sees, newest first: of `history` blocks up to the newest one that may act in it. The
/// state has a piece `commands` for them. Before the breath they were `rest`.
pub(super) fn commands_seen(
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
pub(super) fn pressures(
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

/// The file of a simulator. Of a simulator of several units it contains one: without a choice a physical simulator's first, and for a
/// hybrid a ventilator of none of the recorded ones.
///
/// # Errors
/// A simulator with several commands in each tick, or a unit that it does not have.
pub fn simulator(simulator: &Simulator, unit: Option<u32>) -> Result<Vec<u8>, OnnxError> {
    let timing = *simulator.architecture.timing();
    if timing.channels != 1 {
        return Err(OnnxError::Channels(timing.channels));
    }
    let known = simulator.architecture.members();
    if let Some(asked) = unit.filter(|unit| *unit as usize >= known) {
        return Err(OnnxError::Unit { asked, known });
    }
    let mut graph = Builder::new("simulator");
    let block = Block::input(&mut graph, &timing);
    let parameters = &simulator.parameters;
    let (pressures, state) = match simulator.architecture {
        Architecture::StateSpace(config) => recurrent::state_space(&mut graph, &block, &config, parameters),
        Architecture::Stitched(config) => stitched::stitched(&mut graph, &block, &config, parameters),
        Architecture::Hybrid(config) => hybrid::hybrid(&mut graph, &block, &config, parameters, unit),
        Architecture::Unit(config) => unit::unit(&mut graph, &block, &config, parameters, unit.unwrap_or(0)),
    };
    graph.output(PRESSURES, timing.block_ticks, "pressure after each tick of the block, cmH2O", &pressures);
    let width = state.output(&mut graph);
    let metadata = [
        ("period_us", timing.period_us.to_string()),
        ("block_ticks", timing.block_ticks.to_string()),
        ("state", width.to_string()),
        ("plant", simulator.plant.clone()),
        ("noise", simulator.noise.to_string()),
    ];
    Ok(graph.encode("One block of a learned simulator: see docs/FILES.md of Eupnea", &metadata))
}
