//! Lanes, and the two matrix kernels used by all layers.
//!
//! The kernels select the widest vector unit at run time. Results have the same bits on every machine with such a unit, whatever its
//! width: a fused multiply-add per term, in the order of the inputs or steps, with a sum for each rollout.
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use std::ops::{Index, IndexMut};

use pulp::{Arch, Simd, WithSimd};

/// Number of rollouts per shard.
pub const LANES: usize = 16;

/// One quantity for all rollouts of a shard.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lane(pub [f32; LANES]);

impl Lane {
    /// A lane of zeros.
    pub const ZERO: Self = Self([0.0; LANES]);

    /// The same value for all rollouts.
    #[inline(always)]
    pub const fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    /// A lane with the value `f(l)` for rollout `l`.
    #[inline(always)]
    pub fn from_fn(mut f: impl FnMut(usize) -> f32) -> Self {
        // Without an iterator: with a crate in many units, its steps stay calls and the loop is not vectorised.
        let (mut lane, mut l) = (Self::ZERO, 0);
        while l < LANES {
            lane.0[l] = f(l);
            l += 1;
        }
        lane
    }

    /// Applies `f` to each value.
    #[inline(always)]
    #[must_use]
    pub fn map(self, mut f: impl FnMut(f32) -> f32) -> Self {
        Self::from_fn(|l| f(self.0[l]))
    }

    /// Applies `f` to the two values of each rollout.
    #[inline(always)]
    #[must_use]
    pub fn zip(self, other: &Self, mut f: impl FnMut(f32, f32) -> f32) -> Self {
        Self::from_fn(|l| f(self.0[l], other.0[l]))
    }

    /// Adds `scale * other`.
    #[inline(always)]
    pub fn add_scaled(&mut self, scale: f32, other: &Self) {
        *self = self.zip(other, |a, b| a + scale * b);
    }

    /// Sum over the rollouts.
    #[inline]
    pub fn sum(&self) -> f32 {
        self.0.iter().sum()
    }
}

impl Default for Lane {
    fn default() -> Self {
        Self::ZERO
    }
}

impl Index<usize> for Lane {
    type Output = f32;

    #[inline(always)]
    fn index(&self, rollout: usize) -> &f32 {
        &self.0[rollout]
    }
}

impl IndexMut<usize> for Lane {
    #[inline(always)]
    fn index_mut(&mut self, rollout: usize) -> &mut f32 {
        &mut self.0[rollout]
    }
}

/// Number of outputs kept in registers during one pass over the inputs.
const TILE: usize = 8;

/// The value that a matrix product is added to.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// Nothing: the outputs are overwritten.
    Zero,
    /// A constant for each output; the outputs are overwritten.
    Bias(&'a [f32]),
    /// The present outputs.
    Outputs,
}

/// `y = start + w^T x` for every rollout, with `w` stored input by input: `w[i][o]` at `i * y.len() + o`.
///
/// Shapes: `x` inputs, `y` outputs, `w` inputs times outputs.
pub fn multiply(start: Start<'_>, w: &[f32], x: &[Lane], y: &mut [Lane]) {
    assert_eq!(w.len(), x.len() * y.len(), "weights must have inputs x outputs entries");
    if let Start::Bias(bias) = start {
        assert_eq!(bias.len(), y.len(), "every output needs a bias");
    }
    Arch::new().dispatch(Multiply { start, w, x, y });
}

struct Multiply<'a> {
    start: Start<'a>,
    w: &'a [f32],
    x: &'a [Lane],
    y: &'a mut [Lane],
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let outputs = self.y.len();
        let [tiled, halved] = [TILE, TILE / 2].map(|tile| outputs - outputs % tile);
        for v in 0..LANES / S::F32_LANES {
            for first in (0..tiled).step_by(TILE) {
                multiply_tile::<S, TILE>(simd, &mut self, first, v);
            }
            for first in (tiled..halved).step_by(TILE / 2) {
                multiply_tile::<S, { TILE / 2 }>(simd, &mut self, first, v);
            }
            for first in halved..outputs {
                multiply_tile::<S, 1>(simd, &mut self, first, v);
            }
        }
    }
}

/// Vector `v` of outputs `first..first + N`.
#[inline(always)]
fn multiply_tile<S: Simd, const N: usize>(simd: S, work: &mut Multiply<'_>, first: usize, v: usize) {
    let outputs = work.y.len();
    let tile = first..first + N;
    let mut sums: [S::f32s; N] = match work.start {
        Start::Zero => [simd.splat_f32s(0.0); N],
        Start::Bias(bias) => std::array::from_fn(|o| simd.splat_f32s(bias[first + o])),
        Start::Outputs => std::array::from_fn(|o| vector::<S>(&work.y[first + o], v)),
    };
    for (x, row) in work.x.iter().zip(work.w.chunks_exact(outputs)) {
        let x = vector::<S>(x, v);
        for (sum, w) in sums.iter_mut().zip(&row[tile.clone()]) {
            *sum = simd.mul_add_e_f32s(simd.splat_f32s(*w), x, *sum);
        }
    }
    for (y, sum) in work.y[tile].iter_mut().zip(sums) {
        vectors_mut::<S>(y)[v] = sum;
    }
}

#[inline(always)]
fn vector<S: Simd>(lane: &Lane, v: usize) -> S::f32s {
    vectors::<S>(lane)[v]
}

/// The vectors of a lane.
#[inline(always)]
pub(super) fn vectors<S: Simd>(lane: &Lane) -> &[S::f32s] {
    S::as_simd_f32s(&lane.0).0
}

/// Mutable access to the vectors of a lane.
#[inline(always)]
pub(super) fn vectors_mut<S: Simd>(lane: &mut Lane) -> &mut [S::f32s] {
    S::as_mut_simd_f32s(&mut lane.0).0
}

/// `dw[o][i] += sum over steps and rollouts of dy[t][o] x[t][i]`, with `dw[o][i]` at `o * inputs + i`.
///
/// Shapes: `dy` steps times outputs, `x` steps times inputs.
pub fn outer_add(dy: &[Lane], x: &[Lane], outputs: usize, inputs: usize, dw: &mut [f32]) {
    assert_eq!(dw.len(), outputs * inputs, "gradient must have outputs x inputs entries");
    assert_eq!(dy.len() * inputs, x.len() * outputs, "both must cover the same steps");
    Arch::new().dispatch(OuterAdd { dy, x, outputs, inputs, dw });
}

struct OuterAdd<'a> {
    dy: &'a [Lane],
    x: &'a [Lane],
    outputs: usize,
    inputs: usize,
    dw: &'a mut [f32],
}

impl WithSimd for OuterAdd<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let rows = self.outputs - self.outputs % 4;
        for o in (0..rows).step_by(4) {
            outer_rows::<S, 4>(simd, &mut self, o);
        }
        for o in rows..self.outputs {
            outer_rows::<S, 1>(simd, &mut self, o);
        }
    }
}

/// Gradient of outputs `first..first + O`, in tiles that fill the registers.
#[inline(always)]
fn outer_rows<S: Simd, const O: usize>(simd: S, work: &mut OuterAdd<'_>, first: usize) {
    let wide = if S::REGISTER_COUNT < 32 { 0 } else { work.inputs - work.inputs % 4 };
    let paired = work.inputs - work.inputs % 2;
    for i in (0..wide).step_by(4) {
        outer_tile::<S, O, 4>(simd, work, first, i);
    }
    for i in (wide..paired).step_by(2) {
        outer_tile::<S, O, 2>(simd, work, first, i);
    }
    for i in paired..work.inputs {
        outer_tile::<S, O, 1>(simd, work, first, i);
    }
}

/// Gradient of outputs `first_o..+O` with respect to inputs `first_i..+I`. Each rollout has a sum of its own, whatever the width of
/// a vector.
#[inline(always)]
fn outer_tile<S: Simd, const O: usize, const I: usize>(
    simd: S,
    work: &mut OuterAdd<'_>,
    first_o: usize,
    first_i: usize,
) {
    let mut of_rollouts = [[Lane::ZERO; I]; O];
    for v in 0..LANES / S::F32_LANES {
        let mut sums = [[simd.splat_f32s(0.0); I]; O];
        for (dy, x) in work.dy.chunks_exact(work.outputs).zip(work.x.chunks_exact(work.inputs)) {
            let (dy, x) = (&dy[first_o..first_o + O], &x[first_i..first_i + I]);
            let x: [S::f32s; I] = std::array::from_fn(|i| vector::<S>(&x[i], v));
            for (sums, dy) in sums.iter_mut().zip(dy) {
                let dy = vector::<S>(dy, v);
                for (sum, x) in sums.iter_mut().zip(x) {
                    *sum = simd.mul_add_e_f32s(dy, x, *sum);
                }
            }
        }
        for (lane, sum) in of_rollouts.as_flattened_mut().iter_mut().zip(sums.as_flattened()) {
            vectors_mut::<S>(lane)[v] = *sum;
        }
    }
    for (o, row) in of_rollouts.iter().enumerate() {
        let dw = &mut work.dw[(first_o + o) * work.inputs + first_i..][..I];
        for (dw, lane) in dw.iter_mut().zip(row) {
            *dw += sum_over_rollouts(simd, *lane);
        }
    }
}

/// The sum in an order that suits vectors of any width: the second half is added to the first one until one value is left. So does
/// `reduce_sum_f32s` on every machine.
#[inline(always)]
fn sum_over_rollouts<S: Simd>(simd: S, mut lane: Lane) -> f32 {
    let vectors = vectors_mut::<S>(&mut lane);
    let mut half = LANES / S::F32_LANES / 2;
    while half > 0 {
        for v in 0..half {
            vectors[v] = simd.add_f32s(vectors[v], vectors[v + half]);
        }
        half /= 2;
    }
    simd.reduce_sum_f32s(vectors[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    #[cfg(target_arch = "x86_64")]
    use pulp::x86::{V3, V3_128b, V3_256b, V3_512b, V4};

    /// Numbers without a pattern that could hide tiling errors.
    fn number(seed: usize) -> f32 {
        ((seed * 7919 + 13) % 101) as f32 / 50.0 - 1.0
    }

    fn lanes(count: usize, seed: usize) -> Vec<Lane> {
        (0..count).map(|n| Lane::from_fn(|l| number(seed + n * LANES + l))).collect()
    }

    #[test]
    fn multiply_is_a_matrix_product_for_every_shape_and_start() {
        for (inputs, outputs) in [(1, 1), (3, 8), (24, 32), (7, 13), (16, 1), (5, 2)] {
            let w: Vec<f32> = (0..inputs * outputs).map(number).collect();
            let x = lanes(inputs, 5);
            let start = lanes(outputs, 99);
            let bias: Vec<f32> = (0..outputs).map(|o| number(o + 3)).collect();
            let [mut overwritten, mut biased, mut added] = [start.clone(), start.clone(), start.clone()];
            multiply(Start::Zero, &w, &x, &mut overwritten);
            multiply(Start::Bias(&bias), &w, &x, &mut biased);
            multiply(Start::Outputs, &w, &x, &mut added);
            for (o, l) in (0..outputs).flat_map(|o| (0..LANES).map(move |l| (o, l))) {
                let product: f32 = (0..inputs).map(|i| w[i * outputs + o] * x[i][l]).sum();
                for (y, start) in [(&overwritten, 0.0), (&biased, bias[o]), (&added, start[o][l])] {
                    assert!((y[o][l] - start - product).abs() < 1e-4, "{inputs}x{outputs} at {o},{l}");
                }
            }
        }
    }

    #[test]
    fn outer_add_sums_over_steps_and_rollouts() {
        for (inputs, outputs, steps) in [(1, 1, 1), (24, 32, 10), (7, 5, 3), (16, 1, 4), (3, 6, 2)] {
            let (dy, x) = (lanes(outputs * steps, 3), lanes(inputs * steps, 11));
            let mut dw = vec![0.5; inputs * outputs];
            outer_add(&dy, &x, outputs, inputs, &mut dw);
            for (o, i) in (0..outputs).flat_map(|o| (0..inputs).map(move |i| (o, i))) {
                let expected: f32 =
                    (0..steps).map(|t| dy[t * outputs + o].zip(&x[t * inputs + i], |a, b| a * b).sum()).sum();
                assert!((dw[o * inputs + i] - 0.5 - expected).abs() < 1e-3, "{o},{i}");
            }
        }
    }

    /// Bits of a product and of a gradient with vectors of this width.
    #[cfg(target_arch = "x86_64")]
    fn bits(simd: impl Simd) -> [Vec<u32>; 2] {
        let (inputs, outputs, steps) = (37, 15, 5);
        let w: Vec<f32> = (0..inputs * outputs).map(number).collect();
        let (x, dy) = (lanes(inputs * steps, 5), lanes(outputs * steps, 3));
        let (mut y, mut dw) = (lanes(outputs, 7), w.clone());
        simd.vectorize(Multiply { start: Start::Outputs, w: &w, x: &x[..inputs], y: &mut y });
        simd.vectorize(OuterAdd { dy: &dy, x: &x, outputs, inputs, dw: &mut dw });
        [y.iter().flat_map(|y| y.0).map(f32::to_bits).collect(), dw.iter().map(|dw| dw.to_bits()).collect()]
    }

    #[test]
    #[cfg(target_arch = "x86_64")]
    fn vectors_of_any_width_give_the_same_bits() {
        let Some(v3) = V3::try_new() else { return };
        let expected = bits(v3);
        assert_eq!(bits(V3_128b(v3)), expected);
        assert_eq!(bits(V3_256b(v3)), expected);
        assert_eq!(bits(V3_512b(v3)), expected);
        if let Some(v4) = V4::try_new() {
            assert_eq!(bits(v4), expected);
        }
    }
}
