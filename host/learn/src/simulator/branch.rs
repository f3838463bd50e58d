//! The conductance of a parabolic resistor, which the lungs of both physical models have.
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use engine::number::Number;

/// Conductance of a branch whose pressure difference is `linear * flow + square * flow * |flow|`, at a
/// difference of this size.
#[inline(always)]
pub(super) fn conductance<Q: Number>(linear: Q, square: Q, size: Q) -> Q {
    let root = (linear * linear + linear.constant(4.0) * square * size).sqrt();
    linear.constant(2.0) / (linear + root)
}
