//! The learned residual's network: two hidden layers and one output, on fixed arrays.

use super::features::FEATURES;
use crate::math;

/// Units of the first hidden layer.
pub const HIDDEN_1: usize = 32;
/// Units of the second hidden layer.
pub const HIDDEN_2: usize = 16;
/// Largest magnitude of a weight or bias accepted.
pub const WEIGHT_MAX: f32 = 1.0e3;

/// A fully connected layer, `O` outputs of `I` inputs: `y = weights x + bias`.
#[derive(Clone, Debug, PartialEq)]
pub struct Dense<const I: usize, const O: usize> {
    /// One row per output.
    pub weights: [[f32; I]; O],
    /// One bias per output.
    pub bias: [f32; O],
}

impl<const I: usize, const O: usize> Dense<I, O> {
    /// Number of parameters.
    pub const PARAMETERS: usize = I * O + O;

    /// All parameters zero.
    pub const fn zero() -> Self {
        Self { weights: [[0.0; I]; O], bias: [0.0; O] }
    }

    /// `y = weights x + bias`, summed in the order of the inputs.
    #[inline]
    pub fn forward(&self, x: &[f32; I], y: &mut [f32; O]) {
        for ((y, row), bias) in y.iter_mut().zip(&self.weights).zip(&self.bias) {
            let mut sum = *bias;
            for (w, x) in row.iter().zip(x) {
                sum += w * x;
            }
            *y = sum;
        }
    }

    /// Parameters in storage order: weights row by row, then biases.
    pub fn parameters(&self) -> impl Iterator<Item = &f32> {
        self.weights.as_flattened().iter().chain(&self.bias)
    }

    /// Parameters in storage order, to be written.
    pub fn parameters_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.weights.as_flattened_mut().iter_mut().chain(&mut self.bias)
    }
}

/// Features to residual: softsign, softsign, linear.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// First hidden layer.
    pub hidden_1: Dense<FEATURES, HIDDEN_1>,
    /// Second hidden layer.
    pub hidden_2: Dense<HIDDEN_1, HIDDEN_2>,
    /// Output: the residual as a fraction of full opening.
    pub output: Dense<HIDDEN_2, 1>,
}

impl Network {
    /// Sizes from input to output.
    pub const SHAPE: [usize; 4] = [FEATURES, HIDDEN_1, HIDDEN_2, 1];
    /// Number of parameters.
    pub const PARAMETERS: usize = Dense::<FEATURES, HIDDEN_1>::PARAMETERS
        + Dense::<HIDDEN_1, HIDDEN_2>::PARAMETERS
        + Dense::<HIDDEN_2, 1>::PARAMETERS;

    /// A network that gives zero.
    pub const fn zero() -> Self {
        Self { hidden_1: Dense::zero(), hidden_2: Dense::zero(), output: Dense::zero() }
    }

    /// Residual as a fraction of full opening.
    pub fn forward(&self, features: &[f32; FEATURES]) -> f32 {
        let (mut first, mut second, mut out) = ([0.0; HIDDEN_1], [0.0; HIDDEN_2], [0.0; 1]);
        self.hidden_1.forward(features, &mut first);
        for x in &mut first {
            *x = math::softsign(*x);
        }
        self.hidden_2.forward(&first, &mut second);
        for x in &mut second {
            *x = math::softsign(*x);
        }
        self.output.forward(&second, &mut out);
        out[0]
    }

    /// Parameters in storage order, layer by layer.
    pub fn parameters(&self) -> impl Iterator<Item = &f32> {
        self.hidden_1.parameters().chain(self.hidden_2.parameters()).chain(self.output.parameters())
    }

    /// Parameters in storage order, to be written.
    pub fn parameters_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.hidden_1
            .parameters_mut()
            .chain(self.hidden_2.parameters_mut())
            .chain(self.output.parameters_mut())
    }

    /// Whether every parameter is a number of at most [`WEIGHT_MAX`].
    pub fn is_bounded(&self) -> bool {
        self.parameters().all(|w| w.abs() <= WEIGHT_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layer_multiplies_and_adds() {
        let layer = Dense { weights: [[1.0, 2.0], [3.0, 4.0], [0.0, -1.0]], bias: [0.5, 0.0, 1.0] };
        let mut y = [0.0; 3];
        layer.forward(&[10.0, 1.0], &mut y);
        assert_eq!(y.map(f32::to_bits), [12.5, 34.0, 0.0].map(f32::to_bits));
    }

    #[test]
    fn the_parameter_count_is_what_the_iterator_yields() {
        assert_eq!(Network::zero().parameters().count(), Network::PARAMETERS);
        assert_eq!(Network::zero().parameters_mut().count(), Network::PARAMETERS);
    }

    #[test]
    fn the_network_is_layers_and_activations_in_order() {
        let mut network = Network::zero();
        network.hidden_1.weights[3][0] = 1.0;
        network.hidden_2.weights[2][3] = 1.0;
        network.output.weights[0][2] = 1.0;
        network.output.bias[0] = 0.25;
        let mut features = [0.0; FEATURES];
        features[0] = 1.0;
        // softsign(1) = 1/2, softsign(1/2) = 1/3
        assert!((network.forward(&features) - (1.0 / 3.0 + 0.25)).abs() < 1e-6);
    }

    #[test]
    fn a_single_bad_weight_is_noticed() {
        let mut network = Network::zero();
        assert!(network.is_bounded());
        for bad in [f32::NAN, f32::INFINITY, -2.0 * WEIGHT_MAX] {
            network.hidden_2.weights[15][31] = bad;
            assert!(!network.is_bounded());
        }
    }
}
