//! Equations as a part of a graph: each operation on a [`Symbol`] adds an operator.

use std::cell::RefCell;

use engine::number::{Binary, Number, Unary};
use engine::operators;

use super::{Builder, Value};

/// A graph to which equations add, and the values of their symbols.
#[derive(Debug)]
pub struct Symbols<'g> {
    graph: RefCell<&'g mut Builder>,
    values: RefCell<Vec<Value>>,
}

impl<'g> Symbols<'g> {
    /// Symbols of a graph.
    pub fn new(graph: &'g mut Builder) -> Self {
        Self { graph: RefCell::new(graph), values: RefCell::default() }
    }

    /// A symbol for a value of the graph.
    pub fn of(&self, value: &Value) -> Symbol<'_, 'g> {
        let mut values = self.values.borrow_mut();
        values.push(value.clone());
        Symbol { symbols: self, place: values.len() - 1 }
    }

    /// A symbol for a constant.
    pub fn constant(&self, value: f32) -> Symbol<'_, 'g> {
        let value = self.graph.borrow_mut().number(value);
        self.of(&value)
    }

    fn op(&self, operator: &str, inputs: &[Symbol<'_, '_>]) -> Symbol<'_, 'g> {
        let inputs: Vec<Value> = inputs.iter().map(|symbol| symbol.value()).collect();
        let value = self.graph.borrow_mut().op(operator, &inputs.iter().collect::<Vec<_>>());
        self.of(&value)
    }
}

/// A number of an equation in a graph.
#[derive(Clone, Copy, Debug)]
pub struct Symbol<'s, 'g> {
    symbols: &'s Symbols<'g>,
    place: usize,
}

impl Symbol<'_, '_> {
    /// Its value in the graph.
    pub fn value(self) -> Value {
        self.symbols.values.borrow()[self.place].clone()
    }
}

operators!(Symbol<'_, '_>);

impl Number for Symbol<'_, '_> {
    fn constant(self, value: f32) -> Self {
        self.symbols.constant(value)
    }

    fn one(self, operation: Unary) -> Self {
        self.symbols.op(&format!("{operation:?}"), &[self])
    }

    fn two(self, operation: Binary, other: Self) -> Self {
        self.symbols.op(&format!("{operation:?}"), &[self, other])
    }

    fn where_greater(self, left: Self, right: Self) -> Self {
        let greater = self.symbols.op("Greater", &[left, right]);
        self.symbols.op("Where", &[greater, self, self.constant(0.0)])
    }
}
