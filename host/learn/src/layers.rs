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

/// Number of steps of the backward pass whose gradients are kept until they enter that of the parameters: few enough to stay in the
/// second-level cache with the values of these steps.
const CHUNK: usize = 16;

/// The layers with their parameters, ready to run forward and backward.
#[derive(Clone, Debug)]
pub struct Layers {
    layers: Vec<DenseWeights>,
    activation: Activation,
}

/// Values of a number of steps, and gradients of the backward pass.
#[derive(Clone, Debug)]
pub struct LayersTape {
    /// Inputs of all steps, then the outputs of each layer.
    values: Vec<Vec<Lane>>,
    /// Gradients with respect to the inputs of one step, then with respect to the outputs of each layer in the steps of a chunk.
    gradients: Vec<Vec<Lane>>,
    /// Steps of the chunk that the backward pass has run.
    pending: usize,
    /// Gradient with respect to the parameters over the chunks that are complete, except the first one.
    complete: Vec<f32>,
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
        let after = |first: usize, steps: usize| {
            let outputs = self.layers.iter().map(|layer| steps * layer.shape().outputs);
            [first].into_iter().chain(outputs).map(|lanes| vec![Lane::ZERO; lanes]).collect()
        };
        let end = self.layers.iter().map(|layer| layer.shape().offset + layer.shape().parameters()).max();
        let complete = if steps > CHUNK { end.unwrap_or(0) } else { 0 };
        LayersTape {
            values: after(steps * inputs, steps),
            gradients: after(inputs, steps.min(CHUNK)),
            pending: 0,
            complete: vec![0.0; complete],
        }
    }

    /// Computes the single output of a step from its inputs. Steps follow from first to last.
    pub fn forward(&self, tape: &mut LayersTape, step: usize) -> Lane {
        if step == 0 {
            tape.pending = 0;
            tape.complete.fill(0.0);
        }
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

    /// Outputs of the last hidden layer at a step.
    pub fn hidden<'a>(&self, tape: &'a LayersTape, step: usize) -> &'a [Lane] {
        let last = self.layers.len() - 1;
        piece(&tape.values[last], step, self.layers[last].shape().inputs)
    }

    /// Gradient with respect to a step's inputs, given that with respect to its output. Steps follow from last to first.
    pub fn backward<'a>(&self, tape: &'a mut LayersTape, step: usize, d_output: Lane) -> &'a [Lane] {
        self.backward_with(tape, step, d_output, &[])
    }

    /// [`Self::backward`], given also the gradients with respect to the first outputs of the last hidden layer.
    pub fn backward_with<'a>(
        &self,
        tape: &'a mut LayersTape,
        step: usize,
        d_output: Lane,
        d_hidden: &[Lane],
    ) -> &'a [Lane] {
        let LayersTape { values, gradients, .. } = tape;
        let place = step % CHUNK;
        gradients[self.layers.len()][place] = d_output;
        for (n, layer) in self.layers.iter().enumerate().rev() {
            let DenseLayer { inputs, outputs, .. } = *layer.shape();
            let (before, after) = gradients.split_at_mut(n + 1);
            let d_inputs = piece_mut(&mut before[n], if n == 0 { 0 } else { place }, inputs);
            layer.backward(piece(&after[0], place, outputs), d_inputs);
            if n + 1 == self.layers.len() {
                for (d, more) in d_inputs.iter_mut().zip(d_hidden) {
                    d.add_scaled(1.0, more);
                }
            }
            if n > 0 {
                self.activation.backward(piece(&values[n], step, inputs), d_inputs);
            }
        }
        tape.pending += 1;
        if place == 0 && step > 0 {
            let mut complete = std::mem::take(&mut tape.complete);
            self.add_pending(tape, step, &mut complete);
            (tape.complete, tape.pending) = (complete, 0);
        }
        &tape.gradients[0]
    }

    /// Adds the gradient with respect to the parameters over all steps of the backward pass.
    pub fn finish(&self, tape: &LayersTape, gradient: &mut [f32]) {
        for (sum, complete) in gradient.iter_mut().zip(&tape.complete) {
            *sum += complete;
        }
        self.add_pending(tape, 0, gradient);
    }

    /// Adds the gradient with respect to the parameters over the steps of a chunk, which begins at `first`.
    fn add_pending(&self, tape: &LayersTape, first: usize, gradient: &mut [f32]) {
        for (n, layer) in self.layers.iter().enumerate() {
            let DenseLayer { inputs, outputs, .. } = *layer.shape();
            let d_outputs = &tape.gradients[n + 1][..tape.pending * outputs];
            let inputs = &tape.values[n][first * inputs..][..tape.pending * inputs];
            layer.shape().gradient(d_outputs, inputs, gradient);
        }
    }
}
