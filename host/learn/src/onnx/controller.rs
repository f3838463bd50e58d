//! A learned controller as a graph: one control tick, with the state of the controller as an input and an output.
//!
//! The graph computes what [`Residual`] computes between two observations. It takes the command that was applied in the last tick,
//! which the supervisor and the safety filter may have changed: both are outside, as on the chip.

use shared::control::COMMAND_MAX;
use shared::control::features::{AVERAGES, COMMAND_SCALE, ERROR_SCALE, FeatureSpec, PEEP_SCALE, PIP_SCALE};
use shared::control::memory::bin_ticks;
use shared::control::network::{Dense, Network};
use shared::control::pid::Pid;
use shared::control::residual::Residual;

use super::memory;
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use shared::breath::period_s;

/// Columns of the input `observation`, in their order.
pub const OBSERVATION: [&str; 8] = [
    "measured pressure, cmH2O",
    "target pressure, cmH2O",
    "PIP, cmH2O",
    "PEEP, cmH2O",
    "command applied in the last tick, percent",
    "time since the breath began, s",
    "-1 in a tick; after an inspiration the lesson: 0 adopt, 1 discard, 2 forget",
    "time of the target's rise from PEEP to PIP, s",
];

/// Name of the input.
pub const OBSERVATION_NAME: &str = "observation";
/// Names of the outputs beside the state: the command, and that of the PID alone.
pub const OUTPUTS: [&str; 2] = ["command", "base"];

/// A row of the input `observation`.
pub(super) struct Seen {
    pub(super) pressure: Value,
    pub(super) target: Value,
    pip: Value,
    peep: Value,
    applied: Value,
    /// Time since the start of the breath in whole ticks.
    tick: Value,
    lesson: Value,
    /// Length of the rise in whole ticks.
    rise: Value,
    /// Whether the row is a tick, and whether it is the first one of a breath.
    pub(super) ticks: Value,
    pub(super) starts: Value,
}

impl Seen {
    pub(super) fn input(graph: &mut Builder, period_us: u32) -> Self {
        let doc = OBSERVATION.join("; ");
        let row = graph.input(OBSERVATION_NAME, OBSERVATION.len(), &doc);
        let columns = graph.split(&row, &[1; OBSERVATION.len()]);
        let Ok([pressure, target, pip, peep, applied, time, lesson, rise]) =
            <[Value; OBSERVATION.len()]>::try_from(columns)
        else {
            unreachable!("a split gives as many pieces as asked for")
        };
        let period = graph.number(period_s(period_us));
        let [tick, rise] = [time, rise].map(|time| {
            let exact = graph.div(&time, &period);
            graph.op("Round", &[&exact])
        });
        let zero = graph.number(0.0);
        let ticks = graph.less(&lesson, &zero);
        let half = graph.number(0.5);
        let at_zero = graph.less(&tick, &half);
        let starts = graph.and(&ticks, &at_zero);
        Self { pressure, target, pip, peep, applied, tick, lesson, rise, ticks, starts }
    }
}

/// The file of a controller of our architecture.
pub fn residual(controller: &Residual) -> Vec<u8> {
    let spec = controller.spec();
    let mut graph = Builder::new("controller");
    let seen = Seen::input(&mut graph, spec.period_us);
    let (errors, commands) = histories(&spec.features);
    let mut pieces = vec![
        ("pending", 1),
        ("errors", errors),
        ("commands", commands),
        ("error averages", AVERAGES),
        ("command averages", AVERAGES),
        ("integral", 1),
        ("derivative", 1),
        ("pressure", 1),
        ("has pressure", 1),
    ];
    pieces.extend(memory::PIECES);
    let mut state = State::input(&mut graph, &pieces);
    end_last_tick(&mut graph, &mut state, &seen, controller);
    let learns = graph.not(&seen.ticks);
    memory::learn(&mut graph, &mut state, &learns, &seen.lesson);
    start_breath(&mut graph, &mut state, &seen, (errors, commands));
    let inputs = inputs(&mut graph, &mut state, &seen, controller);
    let output = network(&mut graph, &inputs, controller.network());
    let residual = correction(&mut graph, &output, (spec.lambda, spec.authority));
    let commands = pid(&mut graph, &mut state, &seen, controller.pid(), &residual);
    let pending = graph.flag(&seen.ticks);
    state.set("pending", pending);
    finish(graph, &state, spec.period_us, &commands)
}

/// Declares the outputs: the commands of [`OUTPUTS`], and the state between them, so that outputs and inputs have the same numbers.
pub(super) fn finish(
    mut graph: Builder,
    state: &State,
    period_us: u32,
    [command, base]: &[Value; 2],
) -> Vec<u8> {
    let doc = "percent, before the safety filter";
    graph.output(OUTPUTS[0], 1, doc, command);
    let width = state.output(&mut graph);
    graph.output(OUTPUTS[1], 1, doc, base);
    let metadata = [("period_us", period_us.to_string()), ("state", width.to_string())];
    graph.encode("One control tick of a learned controller: see docs/FILES.md of Eupnea", &metadata)
}

/// Lengths of the histories of errors and commands.
fn histories(spec: &FeatureSpec) -> (usize, usize) {
    let errors = spec.error_taps.iter().max().map_or(0, |tap| usize::from(*tap)) + 1;
    let commands = spec.command_taps.iter().max().map_or(1, |tap| usize::from(*tap));
    (errors, commands)
}

/// Ends the last tick of the breath, if there was one, with the command that was applied.
fn end_last_tick(graph: &mut Builder, state: &mut State, seen: &Seen, controller: &Residual) {
    let features = controller.features();
    let goes_on = graph.not(&seen.starts);
    let pending = graph.at_least(&state.get("pending"), 0.5);
    let ends = graph.and(&pending, &goes_on);
    let scale = graph.number(COMMAND_SCALE);
    let command = graph.div(&seen.applied, &scale);
    let (_, length) = histories(features.spec());
    let commands = graph.pushed(&command, &state.get("commands"), length);
    state.set_where(graph, &ends, "commands", &commands);
    let factors = graph.row(features.command_factors());
    let averages = graph.towards(&state.get("command averages"), &command, &factors);
    state.set_where(graph, &ends, "command averages", &averages);
    let error = graph.columns(&state.get("errors"), &[0]);
    memory::record(graph, state, &ends, (&error, &command), bin_ticks(controller.spec().period_us));
}

/// Forgets the last breath in the rows in which a breath starts.
fn start_breath(graph: &mut Builder, state: &mut State, seen: &Seen, (errors, commands): (usize, usize)) {
    let scale = graph.number(COMMAND_SCALE);
    let command = graph.div(&seen.applied, &scale);
    for (piece, width) in [("commands", commands), ("command averages", AVERAGES)] {
        let ones = graph.row(&vec![1.0; width]);
        let same = graph.mul(&ones, &command);
        state.set_where(graph, &seen.starts, piece, &same);
    }
    for (piece, width) in [
        ("errors", errors),
        ("error averages", AVERAGES),
        ("integral", 1),
        ("derivative", 1),
        ("has pressure", 1),
    ] {
        let zeros = graph.row(&vec![0.0; width]);
        state.set_where(graph, &seen.starts, piece, &zeros);
    }
}

/// Records the observation; the inputs of the network.
fn inputs(graph: &mut Builder, state: &mut State, seen: &Seen, controller: &Residual) -> Value {
    let (features, period_us) = (controller.features(), controller.spec().period_us);
    let spec = features.spec();
    let difference = graph.sub(&seen.target, &seen.pressure);
    let scale = graph.number(ERROR_SCALE);
    let error = graph.div(&difference, &scale);
    let (length, _) = histories(spec);
    let errors = graph.pushed(&error, &state.get("errors"), length);
    state.set_where(graph, &seen.ticks, "errors", &errors);
    let factors = graph.row(features.error_factors());
    let averages = graph.towards(&state.get("error averages"), &error, &factors);
    state.set_where(graph, &seen.ticks, "error averages", &averages);
    let taps = spec.error_taps.map(usize::from);
    let errors = graph.columns(&state.get("errors"), &taps);
    // The last applied command is one tick old.
    let taps = spec.command_taps.map(|tap| usize::from(tap) - 1);
    let commands = graph.columns(&state.get("commands"), &taps);
    let scale = graph.number(COMMAND_SCALE);
    let integral = graph.div(&state.get("integral"), &scale);
    let time = graph.scale(&seen.tick, period_s(period_us));
    let constants = graph.row(&spec.times);
    let later = graph.add(&time, &constants);
    let times = graph.div(&time, &later);
    let mut scaled = |value: &Value, (zero, one): (f32, f32)| {
        let from_zero = graph.shift(value, -zero);
        let one = graph.number(one);
        graph.div(&from_zero, &one)
    };
    let (pip, peep) = (scaled(&seen.pip, PIP_SCALE), scaled(&seen.peep, PEEP_SCALE));
    let rises = rises(graph, seen, spec);
    let recalled = memory::recall(graph, state, &seen.tick, bin_ticks(period_us));
    graph.join(&[
        &errors,
        &commands,
        &state.get("error averages"),
        &state.get("command averages"),
        &integral,
        &times,
        &pip,
        &peep,
        &rises,
        &recalled,
    ])
}

/// Rise of the target ahead, scaled.
fn rises(graph: &mut Builder, seen: &Seen, spec: &FeatureSpec) -> Value {
    let scale = graph.number(ERROR_SCALE);
    let ahead = graph.row(&spec.target_ahead.map(f32::from));
    let then = graph.add(&seen.tick, &ahead);
    let height = graph.sub(&seen.pip, &seen.peep);
    // Where nothing rises, the division by zero is not chosen.
    let mut target = |tick: &Value| {
        let done = graph.div(tick, &seen.rise);
        let risen = graph.mul(&height, &done);
        let rising = graph.add(&seen.peep, &risen);
        let rises = graph.less(tick, &seen.rise);
        graph.choose(&rises, &rising, &seen.pip)
    };
    let (then, now) = (target(&then), target(&seen.tick));
    let rise = graph.sub(&then, &now);
    graph.div(&rise, &scale)
}

/// The output of the network.
fn network(graph: &mut Builder, inputs: &Value, network: &Network) -> Value {
    let first = layer(graph, inputs, &network.hidden_1);
    let first = graph.op("Softsign", &[&first]);
    let second = layer(graph, &first, &network.hidden_2);
    let second = graph.op("Softsign", &[&second]);
    layer(graph, &second, &network.output)
}

/// The residual of an output of a network, percent.
pub(super) fn correction(graph: &mut Builder, output: &Value, (lambda, authority): (f32, f32)) -> Value {
    let wanted = graph.scale(output, lambda * COMMAND_MAX);
    graph.limit(&wanted, -authority, authority)
}

fn layer<const I: usize, const O: usize>(graph: &mut Builder, inputs: &Value, layer: &Dense<I, O>) -> Value {
    let parameters: Vec<f32> = layer.parameters().copied().collect();
    let (weights, bias) = parameters.split_at(I * O);
    graph.dense(inputs, weights, bias)
}

/// The command with the residual, and that of the PID alone.
pub(super) fn pid(
    graph: &mut Builder,
    state: &mut State,
    seen: &Seen,
    pid: &Pid,
    extra: &Value,
) -> [Value; 2] {
    let error = graph.sub(&seen.target, &seen.pressure);
    let change = graph.sub(&seen.pressure, &state.get("pressure"));
    let change = graph.mul(&state.get("has pressure"), &change);
    let wanted = graph.scale(&change, -pid.derivative_scale());
    let factor = graph.number(pid.derivative_factor());
    let derivative = graph.towards(&state.get("derivative"), &wanted, &factor);
    let proportional = graph.scale(&error, pid.gains().p);
    let base = graph.add(&proportional, &state.get("integral"));
    let base = graph.add(&base, &derivative);
    let wanted = graph.add(&base, extra);
    let integral = integral(graph, state, pid, &error, &wanted);
    let known = graph.number(1.0);
    for (piece, value) in [
        ("derivative", &derivative),
        ("integral", &integral),
        ("pressure", &seen.pressure),
        ("has pressure", &known),
    ] {
        state.set_where(graph, &seen.ticks, piece, value);
    }
    [&wanted, &base].map(|percent| graph.limit(percent, 0.0, COMMAND_MAX))
}

/// The integral after the tick: as it was while the command is saturated and the error would drive it further.
fn integral(graph: &mut Builder, state: &State, pid: &Pid, error: &Value, wanted: &Value) -> Value {
    let (zero, most) = (graph.number(0.0), graph.number(COMMAND_MAX));
    let open = graph.op("GreaterOrEqual", &[wanted, &most]);
    let rises = graph.op("Greater", &[error, &zero]);
    let above = graph.and(&open, &rises);
    let closed = graph.op("LessOrEqual", &[wanted, &zero]);
    let falls = graph.less(error, &zero);
    let below = graph.and(&closed, &falls);
    let winds_up = graph.op("Or", &[&above, &below]);
    let step = graph.scale(error, pid.integral_step());
    let next = graph.add(&state.get("integral"), &step);
    let next = graph.limit(&next, -COMMAND_MAX, COMMAND_MAX);
    graph.choose(&winds_up, &state.get("integral"), &next)
}
