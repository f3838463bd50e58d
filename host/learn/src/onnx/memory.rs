//! A controller's memory of earlier breaths as part of a graph: what [`shared::control::memory`] does, on columns.

use shared::control::memory::{
    BINS, COMMANDS_AHEAD, ERRORS_AHEAD, LEARNING, LEAST_BINS, Lesson, NEWEST, PIECES as MIDDLES, Piece,
    SECTIONS, SURPRISE, Section,
};

use crate::graph::state::State;
use crate::graph::{Builder, Value};

/// Pieces of the state: the running bin's sums and ticks; the running breath's bins, their number, its difference to what is
/// remembered and whether one of its values is not finite; the remembered bins, their number, and the breaths adopted.
pub(super) const PIECES: [(&str, usize); 12] = [
    ("sum of errors", 1),
    ("sum of commands", 1),
    ("ticks of the bin", 1),
    ("running errors", BINS),
    ("running commands", BINS),
    ("running bins", 1),
    ("difference", 1),
    ("unsound", 1),
    ("remembered errors", BINS),
    ("remembered commands", BINS),
    ("remembered bins", 1),
    ("adopted", 1),
];

/// The number of a lesson in an observation.
pub fn lesson_number(lesson: Lesson) -> f32 {
    match lesson {
        Lesson::Adopt => 0.0,
        Lesson::Discard => 1.0,
        Lesson::Forget => 2.0,
    }
}

/// Number of ticks of the running bin, and its inverse.
fn running_bin(graph: &mut Builder, state: &State, bin_ticks: u32) -> [Value; 2] {
    let [first, later @ ..] = SECTIONS;
    let ticks = |section: &Section| (bin_ticks * section.width) as f32;
    let numbers = |section: &Section| [ticks(section), 1.0 / ticks(section)];
    let [mut length, mut share] = numbers(&first).map(|number| graph.number(number));
    let mut bins = first.bins;
    for section in &later {
        let here = graph.at_least(&state.get("running bins"), bins as f32);
        let own = numbers(section).map(|number| graph.number(number));
        length = graph.choose(&here, &own[0], &length);
        share = graph.choose(&here, &own[1], &share);
        bins += section.bins;
    }
    [length, share]
}

/// Records error and command of a tick, both scaled, in the rows in which `records` holds.
pub(super) fn record(
    graph: &mut Builder,
    state: &mut State,
    records: &Value,
    (error, command): (&Value, &Value),
    bin_ticks: u32,
) {
    let [bin_ticks, share] = running_bin(graph, state, bin_ticks);
    for (sum, value) in [("sum of errors", error), ("sum of commands", command)] {
        let total = graph.add(&state.get(sum), value);
        state.set_where(graph, records, sum, &total);
    }
    let more = graph.shift(&state.get("ticks of the bin"), 1.0);
    state.set_where(graph, records, "ticks of the bin", &more);
    let full = graph.op("GreaterOrEqual", &[&state.get("ticks of the bin"), &bin_ticks]);
    let full = graph.and(&full, records);
    let new = ["sum of errors", "sum of commands"].map(|sum| graph.mul(&state.get(sum), &share));
    fill(graph, state, &full, &new);
    for piece in ["sum of errors", "sum of commands", "ticks of the bin"] {
        let cleared = graph.cleared(&full, &state.get(piece));
        state.set(piece, cleared);
    }
}

/// Adds a bin to the running breath in the rows in which `full` holds.
fn fill(graph: &mut Builder, state: &mut State, full: &Value, new: &[Value; 2]) {
    let numbers: Vec<f32> = (0..BINS).map(|bin| bin as f32).collect();
    let numbers = graph.row(&numbers);
    let bin = state.get("running bins");
    let (room, known) = (graph.number(BINS as f32), state.get("remembered bins"));
    let room = graph.less(&bin, &room);
    let fills = graph.and(full, &room);
    let known = graph.less(&bin, &known);
    let here = graph.op("Equal", &[&numbers, &bin]);
    let written = graph.and(&here, &fills);
    let newest = graph.number(NEWEST);
    let mut errors = None;
    for (new, running, remembered) in [
        (&new[0], "running errors", "remembered errors"),
        (&new[1], "running commands", "remembered commands"),
    ] {
        let place = graph.flag(&here);
        let old = graph.mul(&place, &state.get(remembered));
        let old = graph.sum(&old);
        let old = graph.choose(&known, &old, new);
        let mean = graph.towards(&old, new, &newest);
        let mean = graph.choose(&known, &mean, new);
        let bins = graph.choose(&written, &mean, &state.get(running));
        state.set(running, bins);
        errors.get_or_insert((new.clone(), old));
    }
    let Some((error, old)) = errors else { return };
    let distance = graph.sub(&error, &old);
    let distance = graph.op("Abs", &[&distance]);
    let difference = graph.add(&state.get("difference"), &distance);
    state.set_where(graph, &fills, "difference", &difference);
    unsound(graph, state, &fills, new);
    let more = graph.shift(&bin, 1.0);
    state.set_where(graph, &fills, "running bins", &more);
}

/// Notes values that are not finite.
fn unsound(graph: &mut Builder, state: &mut State, fills: &Value, new: &[Value; 2]) {
    let both = graph.join(&[&new[0], &new[1]]);
    let magnitude = graph.op("Abs", &[&both]);
    let (sum, most) = (graph.sum(&magnitude), graph.number(f32::MAX));
    let finite = graph.op("LessOrEqual", &[&sum, &most]);
    let wrong = graph.not(&finite);
    let wrong = graph.flag(&wrong);
    let noted = graph.op("Max", &[&state.get("unsound"), &wrong]);
    state.set_where(graph, fills, "unsound", &noted);
}

/// Ends the running breath in the rows in which `learns` holds, as the lesson with this number says.
pub(super) fn learn(graph: &mut Builder, state: &mut State, learns: &Value, lesson: &Value) {
    let filled = state.get("running bins");
    let half = graph.number(0.5);
    let enough = graph.at_least(&filled, LEAST_BINS as f32);
    let finite = graph.less(&state.get("unsound"), &half);
    let sound = graph.and(&enough, &finite);
    let most = graph.scale(&filled, SURPRISE);
    let differs = graph.op("GreaterOrEqual", &[&state.get("difference"), &most]);
    let learned = graph.at_least(&state.get("adopted"), f32::from(LEARNING));
    let surprises = graph.and(&differs, &learned);
    let adopt = graph.less(lesson, &half);
    let adopt = graph.and(&adopt, &sound);
    let adopt = graph.and(&adopt, learns);
    let adopts = graph.not(&surprises);
    let adopts = graph.and(&adopt, &adopts);
    let forgets = graph.and(&adopt, &surprises);
    let told = graph.at_least(lesson, lesson_number(Lesson::Forget) - 0.5);
    let told = graph.and(&told, learns);
    let forgets = graph.op("Or", &[&forgets, &told]);
    for (remembered, running) in [
        ("remembered errors", "running errors"),
        ("remembered commands", "running commands"),
        ("remembered bins", "running bins"),
    ] {
        let value = state.get(running);
        state.set_where(graph, &adopts, remembered, &value);
    }
    let more = graph.shift(&state.get("adopted"), 1.0);
    let more = graph.limit(&more, 0.0, f32::from(LEARNING));
    state.set_where(graph, &adopts, "adopted", &more);
    for (ends, pieces) in [
        (&forgets, &["adopted", "remembered bins"][..]),
        (learns, &["running bins", "sum of errors", "sum of commands", "ticks of the bin"]),
        (learns, &["difference", "unsound"]),
    ] {
        for piece in pieces {
            let cleared = graph.cleared(ends, &state.get(piece));
            state.set(piece, cleared);
        }
    }
}

/// The bin before each time, in shortest bins since the middle of the first one, and the weight of the bin after it.
fn place(graph: &mut Builder, time: &Value) -> (Value, Value) {
    let [first, later @ ..] = MIDDLES;
    let numbers = |piece: &Piece| [piece.from, piece.bin as f32, piece.rate];
    let [mut from, mut bin, mut rate] = numbers(&first).map(|number| graph.number(number));
    for piece in &later {
        let past = graph.at_least(time, piece.from);
        let own = numbers(piece).map(|number| graph.number(number));
        from = graph.choose(&past, &own[0], &from);
        bin = graph.choose(&past, &own[1], &bin);
        rate = graph.choose(&past, &own[2], &rate);
    }
    let since = graph.sub(time, &from);
    let bins = graph.mul(&since, &rate);
    let whole = graph.op("Floor", &[&bins]);
    let share = graph.sub(&bins, &whole);
    (graph.add(&bin, &whole), share)
}

/// What is remembered of the time after a tick: errors, commands, and 1; zeros if nothing is remembered.
pub(super) fn recall(graph: &mut Builder, state: &State, tick: &Value, bin_ticks: u32) -> Value {
    let half = graph.number((bin_ticks / 2) as f32);
    let since = graph.sub(tick, &half);
    let zero = graph.number(0.0);
    let since = graph.op("Max", &[&since, &zero]);
    let bins = graph.number(bin_ticks as f32);
    let now = graph.div(&since, &bins);
    let filled = state.get("remembered bins");
    let last = graph.shift(&filled, -1.0);
    let last = graph.limit(&last, 0.0, (BINS - 1) as f32);
    let mut parts = Vec::new();
    for (bins, ahead) in [("remembered errors", &ERRORS_AHEAD[..]), ("remembered commands", &COMMANDS_AHEAD)]
    {
        let ahead: Vec<f32> = ahead.iter().map(|ahead| *ahead as f32).collect();
        let ahead = graph.row(&ahead);
        let time = graph.add(&now, &ahead);
        let (bin, share) = place(graph, &time);
        let [near, far] = [0.0, 1.0].map(|further| {
            let bin = graph.shift(&bin, further);
            let bin = graph.op("Min", &[&bin, &last]);
            graph.columns_by_row(&state.get(bins), &bin)
        });
        parts.push(graph.towards(&near, &far, &share));
    }
    let known = graph.at_least(&filled, 0.5);
    parts.push(graph.flag(&known));
    let recalled = graph.join(&parts.iter().collect::<Vec<_>>());
    graph.choose(&known, &recalled, &zero)
}
