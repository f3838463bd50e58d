//! The state of a graph: named pieces of one matrix, which is an input and, one step later, an output.

use super::{Builder, Value};

/// Pieces of a state, in the order of its columns.
#[derive(Debug)]
pub struct State {
    names: Vec<&'static str>,
    widths: Vec<usize>,
    values: Vec<Value>,
}

impl State {
    /// Declares the input `state` with these pieces, given by name and width.
    pub fn input(graph: &mut Builder, pieces: &[(&'static str, usize)]) -> Self {
        let widths: Vec<usize> = pieces.iter().map(|(_, width)| *width).collect();
        let all = graph.input("state", widths.iter().sum(), "state; zeros before the first step");
        let values = graph.split(&all, &widths);
        Self { names: pieces.iter().map(|(name, _)| *name).collect(), widths, values }
    }

    fn place(&self, name: &str) -> usize {
        let place = self.names.iter().position(|listed| *listed == name);
        place.expect("a graph uses the pieces that it declares")
    }

    /// The value of a piece at present.
    pub fn get(&self, name: &str) -> Value {
        self.values[self.place(name)].clone()
    }

    /// Replaces a piece.
    pub fn set(&mut self, name: &str, value: Value) {
        let place = self.place(name);
        self.values[place] = value;
    }

    /// Replaces a piece where the condition holds.
    pub fn set_where(&mut self, graph: &mut Builder, condition: &Value, name: &str, value: &Value) {
        let kept = self.get(name);
        let chosen = graph.choose(condition, value, &kept);
        self.set(name, chosen);
    }

    /// Declares the output `next_state`; returns the number of columns.
    pub fn output(&self, graph: &mut Builder) -> usize {
        let all = graph.join(&self.values.iter().collect::<Vec<_>>());
        let width = self.widths.iter().sum();
        graph.output("next_state", width, "state after the step", &all);
        width
    }
}
