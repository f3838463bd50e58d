//! Activations of hidden layers on lanes: softsign as on the chip, and those of the authors' networks.
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use pulp::{Arch, Simd, WithSimd};
use serde::{Deserialize, Serialize};

use super::Lane;
use super::lane::{vectors, vectors_mut};

/// An activation function.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// `x / (1 + |x|)`.
    Softsign,
    /// Hyperbolic tangent (the authors' boundary networks).
    Tanh,
    /// Scaled exponential linear unit (the authors' default network).
    Selu,
    /// Rectified linear unit, `max(x, 0)` (the authors' controller).
    Relu,
}

/// Constants of the scaled exponential linear unit (Klambauer et al. 2017).
const SELU_SCALE: f32 = 1.050_701;
const SELU_ALPHA: f32 = 1.673_263_2;

impl Activation {
    /// Replaces each value by its activation.
    pub fn forward(self, values: &mut [Lane]) {
        match self {
            Self::Softsign => Arch::new().dispatch(Softsign { values }),
            Self::Tanh => apply(values, f32::tanh),
            Self::Selu => apply(values, |x| SELU_SCALE * if x > 0.0 { x } else { SELU_ALPHA * x.exp_m1() }),
            Self::Relu => apply(values, |x| x.max(0.0)),
        }
    }

    /// Multiplies each gradient by the slope, computed from the activation's *output*.
    pub fn backward(self, outputs: &[Lane], gradients: &mut [Lane]) {
        match self {
            Self::Softsign => Arch::new().dispatch(SoftsignBack { outputs, gradients }),
            Self::Tanh => scale(outputs, gradients, |y| 1.0 - y * y),
            Self::Selu => {
                scale(outputs, gradients, |y| if y > 0.0 { SELU_SCALE } else { y + SELU_SCALE * SELU_ALPHA });
            }
            Self::Relu => scale(outputs, gradients, |y| if y > 0.0 { 1.0 } else { 0.0 }),
        }
    }
}

fn apply(values: &mut [Lane], f: impl Fn(f32) -> f32) {
    Arch::new().dispatch(Apply { values, f });
}

fn scale(outputs: &[Lane], gradients: &mut [Lane], slope: impl Fn(f32) -> f32) {
    Arch::new().dispatch(Scale { outputs, gradients, slope });
}

struct Apply<'a, F> {
    values: &'a mut [Lane],
    f: F,
}

impl<F: Fn(f32) -> f32> WithSimd for Apply<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for lane in self.values {
            *lane = lane.map(&self.f);
        }
    }
}

struct Scale<'a, F> {
    outputs: &'a [Lane],
    gradients: &'a mut [Lane],
    slope: F,
}

impl<F: Fn(f32) -> f32> WithSimd for Scale<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (output, gradient) in self.outputs.iter().zip(self.gradients) {
            *gradient = gradient.zip(output, |gradient, output| gradient * (self.slope)(output));
        }
    }
}

/// The bits of [`shared::math::softsign`]. In vector operations by name: of a loop over lanes, the compiler makes vectors of one
/// rollout in several lanes, which it gathers value by value.
struct Softsign<'a> {
    values: &'a mut [Lane],
}

impl WithSimd for Softsign<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let one = simd.splat_f32s(1.0);
        for lane in self.values {
            for x in vectors_mut::<S>(lane) {
                *x = simd.div_f32s(*x, simd.add_f32s(one, simd.abs_f32s(*x)));
            }
        }
    }
}

struct SoftsignBack<'a> {
    outputs: &'a [Lane],
    gradients: &'a mut [Lane],
}

impl WithSimd for SoftsignBack<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let one = simd.splat_f32s(1.0);
        for (output, gradient) in self.outputs.iter().zip(self.gradients) {
            for (y, gradient) in vectors::<S>(output).iter().zip(vectors_mut::<S>(gradient)) {
                let rest = simd.sub_f32s(one, simd.abs_f32s(*y));
                *gradient = simd.mul_f32s(*gradient, simd.mul_f32s(rest, rest));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::math;

    #[test]
    fn softsign_has_the_bits_of_the_chip() {
        for n in 0..1000_u16 {
            let x = Lane::from_fn(|l| (f32::from(n) * 16.0 + l as f32).sin() * f32::from(n));
            let mut values = [x];
            Activation::Softsign.forward(&mut values);
            assert_eq!(values[0].0.map(f32::to_bits), x.0.map(|x| math::softsign(x).to_bits()), "{x:?}");
        }
    }

    #[test]
    fn slopes_agree_with_finite_differences() {
        for activation in [Activation::Softsign, Activation::Tanh, Activation::Selu, Activation::Relu] {
            let at = |x: f32| {
                let mut lane = [Lane::splat(x)];
                activation.forward(&mut lane);
                lane
            };
            for x in [-3.0, -0.7, -0.1, 0.2, 1.1, 4.0] {
                let mut slope = [Lane::splat(1.0)];
                activation.backward(&at(x), &mut slope);
                let step = 1e-2;
                let numeric = (at(x + step)[0][0] - at(x - step)[0][0]) / (2.0 * step);
                assert!((slope[0][0] - numeric).abs() < 2e-3, "{activation:?} at {x}");
            }
        }
    }
}
