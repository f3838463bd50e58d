//! The network of the learned residual: two hidden layers and one output, on fixed arrays.
//!
//! Every sum starts with its bias and adds the inputs in order, with each product rounded before it is added. So host and
//! chip get the same bits, however many sums are computed side by side.
//!
//! # Shape of the code
//! A Cortex-M4F needs at least two instructions for each weight, a load and a multiply-add (which rounds twice), since
//! compilers load one float at a time. All other instructions are kept few:
//!
//! - `BLOCK` sums are computed side by side, so that an input is loaded once for all of them. They use half of the core's
//!   32 float registers; with more sums too few registers would remain for weights and inputs.
//! - Weights are stored input by input, so that those of a block are contiguous and addressed from one base.
//! - The loop handles `STEP` inputs per iteration. With twice as many the compiler spills inputs to the stack.
//! - Each layer is a function of its own, with the layer's address as the base of all accesses: inlined into the network,
//!   most weights would be too far from the base for the immediate offset of a load.
//!
//! `cargo xtask cost` counts the instructions.

use core::iter;

use super::features::FEATURES;
use super::memory::RECALLED;
use crate::math;

/// Units of the first hidden layer.
pub const HIDDEN_1: usize = 32;
/// Units of the second hidden layer.
pub const HIDDEN_2: usize = 16;
/// Largest accepted magnitude of a weight or bias.
pub const WEIGHT_MAX: f32 = 1.0e3;

/// Number of outputs that are summed side by side.
const BLOCK: usize = 16;
/// Number of inputs per iteration of the loop.
const STEP: usize = 4;

/// A fully connected layer with `I` inputs and `O` outputs: `y = weights x + bias`.
#[derive(Clone, Debug, PartialEq)]
pub struct Dense<const I: usize, const O: usize> {
    /// One row per input, with its weight for each output.
    pub weights: [[f32; O]; I],
    /// One bias per output.
    pub bias: [f32; O],
}

impl<const I: usize, const O: usize> Dense<I, O> {
    /// Number of parameters.
    pub const PARAMETERS: usize = I * O + O;

    /// All parameters zero.
    pub const fn zero() -> Self {
        Self { weights: [[0.0; O]; I], bias: [0.0; O] }
    }

    /// `y = activation(weights x + bias)`, summed in the order of the inputs.
    #[inline(never)]
    pub fn forward(&self, x: &[f32; I], y: &mut [f32; O], activation: impl Fn(f32) -> f32) {
        let (blocks, rest) = y.as_chunks_mut::<BLOCK>();
        let done = blocks.as_flattened().len();
        for (index, y) in blocks.iter_mut().enumerate() {
            *y = self.outputs(index, x, &activation);
        }
        for (index, y) in rest.iter_mut().enumerate() {
            [*y] = self.outputs(done + index, x, &activation);
        }
    }

    /// Computes block number `block` of the outputs, divided into blocks of `R`.
    #[inline]
    fn outputs<const R: usize>(
        &self,
        block: usize,
        x: &[f32; I],
        activation: impl Fn(f32) -> f32,
    ) -> [f32; R] {
        let mut sums = self.bias.as_chunks().0[block];
        let (x, last_x) = x.as_chunks::<STEP>();
        let (rows, last_rows) = self.weights.as_chunks::<STEP>();
        for (x, rows) in x.iter().zip(rows) {
            for (x, row) in x.iter().zip(rows) {
                add_scaled(&mut sums, *x, &row.as_chunks().0[block]);
            }
        }
        for (x, row) in last_x.iter().zip(last_rows) {
            add_scaled(&mut sums, *x, &row.as_chunks().0[block]);
        }
        sums.map(activation)
    }

    /// Parameters in storage order: all weights of the first output, then of the second and so on, then the biases.
    pub fn parameters(&self) -> impl Iterator<Item = &f32> {
        let weights = (0..O).flat_map(|output| self.weights.iter().map(move |row| &row[output]));
        weights.chain(&self.bias)
    }

    /// Mutable access to the parameters in storage order.
    pub fn parameters_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        let mut rows = self.weights.each_mut().map(|row| row.iter_mut());
        let mut inputs = (0..I).cycle();
        let weights = iter::from_fn(move || rows[inputs.next()?].next());
        weights.chain(&mut self.bias)
    }
}

/// `sums += x weights`; product and sum are rounded separately.
#[inline]
fn add_scaled<const R: usize>(sums: &mut [f32; R], x: f32, weights: &[f32; R]) {
    for (sum, weight) in sums.iter_mut().zip(weights) {
        *sum += weight * x;
    }
}

/// Number of inputs of the residual's network: the features, then what earlier breaths have taught.
pub const INPUTS: usize = FEATURES + RECALLED;

/// The residual's network: from features to the residual before scaling by lambda, as a fraction of full opening.
pub type Network = Perceptron<INPUTS, HIDDEN_1, HIDDEN_2>;

/// A network with two hidden layers and one linear output.
#[derive(Clone, Debug, PartialEq)]
pub struct Perceptron<const I: usize, const H1: usize, const H2: usize> {
    /// First hidden layer.
    pub hidden_1: Dense<I, H1>,
    /// Second hidden layer.
    pub hidden_2: Dense<H1, H2>,
    /// Output layer, linear.
    pub output: Dense<H2, 1>,
}

impl<const I: usize, const H1: usize, const H2: usize> Perceptron<I, H1, H2> {
    /// Sizes of the layers from input to output.
    pub const SHAPE: [usize; 4] = [I, H1, H2, 1];
    /// Number of parameters.
    pub const PARAMETERS: usize =
        Dense::<I, H1>::PARAMETERS + Dense::<H1, H2>::PARAMETERS + Dense::<H2, 1>::PARAMETERS;

    /// A network whose output is always zero.
    pub const fn zero() -> Self {
        Self { hidden_1: Dense::zero(), hidden_2: Dense::zero(), output: Dense::zero() }
    }

    /// Computes the output, with softsign in the hidden layers.
    pub fn forward(&self, inputs: &[f32; I]) -> f32 {
        self.forward_with(inputs, math::softsign)
    }

    /// Computes the output, with any activation in the hidden layers.
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

    /// Mutable access to the parameters in storage order.
    pub fn parameters_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.hidden_1
            .parameters_mut()
            .chain(self.hidden_2.parameters_mut())
            .chain(self.output.parameters_mut())
    }

    /// Whether every parameter is a number with a magnitude of at most [`WEIGHT_MAX`].
    pub fn is_bounded(&self) -> bool {
        self.parameters().all(|w| w.abs() <= WEIGHT_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Numbers of inputs and outputs that are no multiples of [`STEP`] and [`BLOCK`].
    type Odd = Dense<7, 19>;

    fn odd(parameters: &[f32]) -> Odd {
        let mut layer = Odd::zero();
        for (parameter, value) in layer.parameters_mut().zip(parameters) {
            *parameter = *value;
        }
        layer
    }

    proptest! {
        #[test]
        fn blocks_change_no_bit_of_a_sum_in_the_order_of_the_inputs(
            parameters in prop::collection::vec(-1.0e3f32..1.0e3, Odd::PARAMETERS),
            x in prop::array::uniform7(-1.0e3f32..1.0e3),
        ) {
            let (weights, bias) = parameters.split_at(7 * 19);
            let one_by_one = |output: usize| {
                let row = &weights[7 * output..7 * (output + 1)];
                row.iter().zip(&x).fold(bias[output], |sum, (weight, x)| sum + weight * x)
            };
            let mut y = [0.0; 19];
            odd(&parameters).forward(&x, &mut y, |sum| -sum);
            for (output, y) in y.iter().enumerate() {
                prop_assert_eq!(y.to_bits(), (-one_by_one(output)).to_bits());
            }
        }
    }

    #[test]
    fn parameters_are_read_in_the_order_in_which_they_are_written() {
        let parameters: Vec<f32> = (0..Odd::PARAMETERS).map(|n| n as f32).collect();
        let layer = odd(&parameters);
        assert_eq!(layer.parameters().copied().collect::<Vec<_>>(), parameters);
        assert!(
            (layer.weights[2][1] - 9.0).abs() < f32::EPSILON,
            "the second output's weight of the third input"
        );
    }

    #[test]
    fn a_layer_multiplies_and_adds() {
        let layer = Dense { weights: [[1.0, 3.0, 0.0], [2.0, 4.0, -1.0]], bias: [0.5, 0.0, 1.0] };
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
        network.hidden_1.weights[0][3] = 1.0;
        network.hidden_2.weights[3][2] = 1.0;
        network.output.weights[2][0] = 1.0;
        network.output.bias[0] = 0.25;
        let mut features = [0.0; INPUTS];
        features[0] = 1.0;
        // softsign(1) = 1/2, softsign(1/2) = 1/3
        assert!((network.forward(&features) - (1.0 / 3.0 + 0.25)).abs() < 1e-6);
    }

    #[test]
    fn a_single_bad_weight_is_noticed() {
        let mut network = Network::zero();
        assert!(network.is_bounded());
        for bad in [f32::NAN, f32::INFINITY, -2.0 * WEIGHT_MAX] {
            network.hidden_2.weights[31][15] = bad;
            assert!(!network.is_bounded());
        }
    }
}
