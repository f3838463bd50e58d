//! The conductance of a parabolic resistor, which the lungs of both physical models have.

use engine::number::Number;

/// Conductance of a branch whose pressure difference is `linear * flow + square * flow * |flow|`, at a
/// difference of this size.
#[inline]
pub(super) fn conductance<Q: Number>(linear: Q, square: Q, size: Q) -> Q {
    let root = (linear * linear + linear.constant(4.0) * square * size).sqrt();
    linear.constant(2.0) / (linear + root)
}
