//! The conductance of a parabolic resistor, which the lungs of both physical models have.

use crate::graph::{Builder, Value};

/// Conductance of a branch whose pressure difference is `linear * flow + square * flow * |flow|`, at a difference of this size,
/// `2 / (linear + root)`; and the root, `sqrt(linear^2 + 4 square size)`, for its slopes.
pub(super) fn conductance(linear: f32, square: f32, size: f32) -> (f32, f32) {
    let root = (linear * linear + 4.0 * square * size).sqrt();
    (2.0 / (linear + root), root)
}

/// [`conductance`] as a graph, from `linear`, its square, and four times `square`.
pub(super) fn conductance_graph(
    graph: &mut Builder,
    [linear, linear_square, four_square]: [&Value; 3],
    size: &Value,
) -> Value {
    let root = graph.mul(four_square, size);
    let root = graph.add(linear_square, &root);
    let root = graph.op("Sqrt", &[&root]);
    let sum = graph.add(linear, &root);
    let two = graph.number(2.0);
    graph.div(&two, &sum)
}
