//! The learned residual's network: two hidden layers and one output, on fixed arrays.

use super::features::FEATURES;
use crate::math;

/// Units of the first hidden layer.
pub const HIDDEN_1: usize = 32;
/// Units of the second hidden layer.
pub const HIDDEN_2: usize = 16;
/// Largest magnitude of a weight or bias accepted.
pub const WEIGHT_MAX: f32 = 1.0e3;

/// Rows that are summed side by side, so that an input is loaded once for all of them.
const ROWS: usize = 4;

/// Sums of some rows, each in the order of the inputs: the number of rows changes no bit.
#[inline]
fn rows_times<const I: usize, const R: usize>(
    rows: &[[f32; I]; R],
    x: &[f32; I],
    bias: [f32; R],
) -> [f32; R] {
    let mut sums = bias;
    for (column, x) in x.iter().enumerate() {
        for (sum, row) in sums.iter_mut().zip(rows) {
            *sum += row[column] * x;
        }
    }
    sums
}

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

    /// `y = activation(weights x + bias)`, summed in the order of the inputs.
    #[inline]
    pub fn forward(&self, x: &[f32; I], y: &mut [f32; O], activation: impl Fn(f32) -> f32) {
        let (blocks, rest) = self.weights.as_chunks::<ROWS>();
        let (sums, last) = y.as_chunks_mut::<ROWS>();
        let (biases, last_biases) = self.bias.as_chunks::<ROWS>();
        for ((sums, rows), bias) in sums.iter_mut().zip(blocks).zip(biases) {
            *sums = rows_times(rows, x, *bias).map(&activation);
        }
        for ((sum, row), bias) in last.iter_mut().zip(rest).zip(last_biases) {
            [*sum] = rows_times(core::array::from_ref(row), x, [*bias]).map(&activation);
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

/// The residual's network: features to residual as a fraction of full opening.
pub type Network = Perceptron<FEATURES, HIDDEN_1, HIDDEN_2>;

/// Two hidden layers and one linear output.
#[derive(Clone, Debug, PartialEq)]
pub struct Perceptron<const I: usize, const H1: usize, const H2: usize> {
    /// First hidden layer.
    pub hidden_1: Dense<I, H1>,
    /// Second hidden layer.
    pub hidden_2: Dense<H1, H2>,
    /// Output.
    pub output: Dense<H2, 1>,
}

impl<const I: usize, const H1: usize, const H2: usize> Perceptron<I, H1, H2> {
    /// Sizes from input to output.
    pub const SHAPE: [usize; 4] = [I, H1, H2, 1];
    /// Number of parameters.
    pub const PARAMETERS: usize =
        Dense::<I, H1>::PARAMETERS + Dense::<H1, H2>::PARAMETERS + Dense::<H2, 1>::PARAMETERS;

    /// A network that gives zero.
    pub const fn zero() -> Self {
        Self { hidden_1: Dense::zero(), hidden_2: Dense::zero(), output: Dense::zero() }
    }

    /// The output, with softsign in the hidden layers.
    pub fn forward(&self, inputs: &[f32; I]) -> f32 {
        self.forward_with(inputs, math::softsign)
    }

    /// The output, with any activation in the hidden layers.
    #[inline]
    pub fn forward_with(&self, inputs: &[f32; I], activation: impl Fn(f32) -> f32) -> f32 {
        let (mut first, mut second, mut out) = ([0.0; H1], [0.0; H2], [0.0; 1]);
        self.hidden_1.forward(inputs, &mut first, &activation);
        self.hidden_2.forward(&first, &mut second, &activation);
        self.output.forward(&second, &mut out, |sum| sum);
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
        layer.forward(&[10.0, 1.0], &mut y, |sum| sum);
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
