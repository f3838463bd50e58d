//! A stack of dense layers with one activation between them, forward and backward over the steps of a rollout.

use engine::Lane;
use engine::activation::Activation;
use engine::dense::{DenseLayer, DenseWeights};

/// The `n`-th piece of `width` lanes.
pub(crate) fn piece(lanes: &[Lane], n: usize, width: usize) -> &[Lane] {
    &lanes[n * width..(n + 1) * width]
}

/// Mutable access to the `n`-th piece of `width` lanes.
pub(crate) fn piece_mut(lanes: &mut [Lane], n: usize, width: usize) -> &mut [Lane] {
    &mut lanes[n * width..(n + 1) * width]
}

/// The layers with their parameters, ready to run forward and backward.
#[derive(Clone, Debug)]
pub struct Layers {
    layers: Vec<DenseWeights>,
    activation: Activation,
}

/// Values and gradients of a number of steps.
#[derive(Clone, Debug)]
pub struct LayersTape {
    /// Inputs of all steps, then the outputs of each layer.
    values: Vec<Vec<Lane>>,
    /// Gradients with respect to the inputs of one step, then with respect to the outputs of each layer in all steps.
    gradients: Vec<Vec<Lane>>,
}

impl LayersTape {
    /// Mutable access to the inputs of a step.
    pub fn inputs(&mut self, step: usize) -> &mut [Lane] {
        let width = self.gradients[0].len();
        piece_mut(&mut self.values[0], step, width)
    }
}

impl Layers {
    /// The layers of a parameter vector.
    pub fn new(shapes: &[DenseLayer], activation: Activation, parameters: &[f32]) -> Self {
        Self { layers: shapes.iter().map(|layer| layer.load(parameters)).collect(), activation }
    }

    /// Memory for `steps` steps.
    pub fn tape(&self, steps: usize) -> LayersTape {
        let inputs = self.layers[0].shape().inputs;
        let outputs = self.layers.iter().map(|layer| vec![Lane::ZERO; steps * layer.shape().outputs]);
        let after = |first: usize| [vec![Lane::ZERO; first]].into_iter().chain(outputs.clone()).collect();
        LayersTape { values: after(steps * inputs), gradients: after(inputs) }
    }

    /// Computes the single output of a step from its inputs.
    pub fn forward(&self, tape: &mut LayersTape, step: usize) -> Lane {
        let mut output = Lane::ZERO;
        for (n, layer) in self.layers.iter().enumerate() {
            let DenseLayer { inputs, outputs, .. } = *layer.shape();
            let (before, after) = tape.values.split_at_mut(n + 1);
            let after = piece_mut(&mut after[0], step, outputs);
            layer.forward(piece(&before[n], step, inputs), after);
            if n + 1 < self.layers.len() {
                self.activation.forward(after);
            }
            output = after[0];
        }
        output
    }

    /// Gradient with respect to a step's inputs, given that with respect to its output.
    pub fn backward<'a>(&self, tape: &'a mut LayersTape, step: usize, d_output: Lane) -> &'a [Lane] {
        let LayersTape { values, gradients } = tape;
        gradients[self.layers.len()][step] = d_output;
        for (n, layer) in self.layers.iter().enumerate().rev() {
            let DenseLayer { inputs, outputs, .. } = *layer.shape();
            let (before, after) = gradients.split_at_mut(n + 1);
            let d_inputs = piece_mut(&mut before[n], if n == 0 { 0 } else { step }, inputs);
            layer.backward(piece(&after[0], step, outputs), d_inputs);
            if n > 0 {
                self.activation.backward(piece(&values[n], step, inputs), d_inputs);
            }
        }
        &gradients[0]
    }

    /// Adds the gradient with respect to the parameters over the first `steps` steps.
    pub fn finish(&self, tape: &LayersTape, steps: usize, gradient: &mut [f32]) {
        for (n, layer) in self.layers.iter().enumerate() {
            let DenseLayer { inputs, outputs, .. } = *layer.shape();
            let (dy, x) = (&tape.gradients[n + 1][..steps * outputs], &tape.values[n][..steps * inputs]);
            layer.shape().gradient(dy, x, gradient);
        }
    }
}
