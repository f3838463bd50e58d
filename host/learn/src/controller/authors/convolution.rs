//! The authors' network: a convolution along ten inputs (100 channels, a kernel of 5, no padding), a rectifier, and one dense
//! output.
//!
//! The kernel is a dense layer from five neighbouring inputs to all channels, applied at six positions. The hidden values of a
//! breath would take tens of megabytes, so the backward pass computes those of each tick again.

use engine::Lane;
use engine::activation::Activation;
use engine::dense::{DenseLayer, DenseWeights};
use rand_chacha::ChaCha8Rng;

use super::averages::ERRORS;
use crate::layers::{piece, piece_mut};

/// Channels of the convolution.
const CHANNELS: usize = 100;
/// Width of the kernel.
pub(crate) const KERNEL: usize = 5;
/// Positions of the kernel along the inputs.
pub(crate) const POSITIONS: usize = ERRORS - KERNEL + 1;
/// Number of parameters.
pub(super) const PARAMETERS: usize = (KERNEL + 1) * CHANNELS + POSITIONS * CHANNELS + 1;

/// Kernel and output layer within a parameter vector: weights of the kernel channel by channel, biases of the channels, weights of
/// the output position by position, its bias.
pub(crate) fn layout() -> [DenseLayer; 2] {
    DenseLayer::layout([(KERNEL, CHANNELS), (POSITIONS * CHANNELS, 1)]).0
}

/// Parameters with a random kernel and an output of zero.
pub(super) fn initial_parameters(rng: &mut ChaCha8Rng) -> Vec<f32> {
    let mut parameters = vec![0.0; PARAMETERS];
    let [kernel, _] = layout();
    kernel.initialise(&mut parameters, 1.0, rng);
    parameters
}

/// The output for one breath.
pub(super) fn output(parameters: &[f32], inputs: &[f32; ERRORS]) -> f32 {
    let [kernel, output] = layout().map(|layer| layer.slice(parameters));
    let (kernel, biases) = kernel.split_at(KERNEL * CHANNELS);
    let (weights, bias) = output.split_at(POSITIONS * CHANNELS);
    let mut sum = bias[0];
    for (window, weights) in inputs.windows(KERNEL).zip(weights.chunks_exact(CHANNELS)) {
        for ((row, bias), weight) in kernel.chunks_exact(KERNEL).zip(biases).zip(weights) {
            let channel = row.iter().zip(window).fold(*bias, |sum, (w, x)| sum + w * x);
            sum += weight * channel.max(0.0);
        }
    }
    sum
}

/// The network over lanes.
#[derive(Clone, Debug)]
pub struct Convolution {
    kernel: DenseWeights,
    output: DenseWeights,
}

/// Inputs of all ticks, the hidden values of one, and the gradient so far.
#[derive(Debug)]
pub struct ConvolutionTape {
    inputs: Vec<Lane>,
    hidden: Vec<Lane>,
    d_hidden: Vec<Lane>,
    d_inputs: Vec<Lane>,
    /// The inputs at each position of the kernel.
    windows: Vec<Lane>,
    gradient: Vec<f32>,
}

impl ConvolutionTape {
    /// Memory for `ticks` ticks.
    pub(super) fn new(ticks: usize) -> Self {
        let lanes = |count| vec![Lane::ZERO; count];
        Self {
            inputs: lanes(ticks * ERRORS),
            hidden: lanes(POSITIONS * CHANNELS),
            d_hidden: lanes(POSITIONS * CHANNELS),
            d_inputs: lanes(ERRORS),
            windows: lanes(POSITIONS * KERNEL),
            gradient: vec![0.0; PARAMETERS],
        }
    }

    /// Mutable access to the inputs of a tick.
    pub(super) fn inputs(&mut self, tick: usize) -> &mut [Lane] {
        piece_mut(&mut self.inputs, tick, ERRORS)
    }

    /// Starts the backward pass of a breath.
    pub(super) fn start_back(&mut self) {
        self.gradient.fill(0.0);
    }
}

impl Convolution {
    /// The network of a parameter vector.
    pub(super) fn new(parameters: &[f32]) -> Self {
        let [kernel, output] = layout().map(|layer| layer.load(parameters));
        Self { kernel, output }
    }

    /// The rectified channels at all positions, from the inputs of a tick.
    fn hidden_values(&self, inputs: &[Lane], hidden: &mut [Lane]) {
        for (window, channels) in inputs.windows(KERNEL).zip(hidden.chunks_exact_mut(CHANNELS)) {
            self.kernel.forward(window, channels);
        }
        Activation::Relu.forward(hidden);
    }

    /// The output of a tick from its inputs.
    pub(super) fn forward(&self, tape: &mut ConvolutionTape, tick: usize) -> Lane {
        self.hidden_values(piece(&tape.inputs, tick, ERRORS), &mut tape.hidden);
        let mut output = [Lane::ZERO];
        self.output.forward(&tape.hidden, &mut output);
        output[0]
    }

    /// Gradient with respect to a tick's inputs, given that with respect to its output; adds up that with respect to the
    /// parameters.
    pub(super) fn backward<'a>(
        &self,
        tape: &'a mut ConvolutionTape,
        tick: usize,
        d_output: Lane,
    ) -> &'a [Lane] {
        let ConvolutionTape { inputs, hidden, d_hidden, d_inputs, windows, gradient } = tape;
        let inputs = piece(inputs, tick, ERRORS);
        self.hidden_values(inputs, hidden);
        self.output.backward(&[d_output], d_hidden);
        Activation::Relu.backward(hidden, d_hidden);
        d_inputs.fill(Lane::ZERO);
        for (n, d_channels) in d_hidden.chunks_exact(CHANNELS).enumerate() {
            self.kernel.backward_add(d_channels, &mut d_inputs[n..n + KERNEL]);
            piece_mut(windows, n, KERNEL).copy_from_slice(&inputs[n..n + KERNEL]);
        }
        self.output.shape().gradient(&[d_output], hidden, gradient);
        self.kernel.shape().gradient(d_hidden, windows, gradient);
        d_inputs
    }

    /// Adds the gradient with respect to the parameters.
    pub(super) fn finish(tape: &ConvolutionTape, gradient: &mut [f32]) {
        for (sum, part) in gradient.iter_mut().zip(&tape.gradient) {
            *sum += part;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::LANES;
    use rand_chacha::rand_core::SeedableRng;

    fn parameters() -> Vec<f32> {
        let mut parameters = initial_parameters(&mut ChaCha8Rng::seed_from_u64(9));
        for (n, p) in parameters.iter_mut().enumerate() {
            *p += 0.1 * (n as f32).sin();
        }
        parameters
    }

    fn with_inputs() -> ConvolutionTape {
        let mut tape = ConvolutionTape::new(1);
        for (i, lane) in tape.inputs(0).iter_mut().enumerate() {
            *lane = Lane::from_fn(|l| ((i * 3 + l) as f32).cos());
        }
        tape
    }

    #[test]
    fn lanes_and_one_breath_agree() {
        let (parameters, mut tape) = (parameters(), with_inputs());
        let lanes = Convolution::new(&parameters).forward(&mut tape, 0);
        for l in 0..LANES {
            let inputs = std::array::from_fn(|i| tape.inputs(0)[i][l]);
            let one = output(&parameters, &inputs);
            assert!((one - lanes[l]).abs() < 1e-4, "{one} against {}", lanes[l]);
        }
    }

    #[test]
    fn every_position_has_the_same_kernel_and_weights_of_its_own() {
        let mut parameters = vec![0.0; PARAMETERS];
        // Channel 3 passes on the last input of a window; the output weighs it at the last position.
        parameters[3 * KERNEL + KERNEL - 1] = 1.0;
        parameters[(KERNEL + 1) * CHANNELS + (POSITIONS - 1) * CHANNELS + 3] = 2.0;
        let mut inputs = [0.5; ERRORS];
        inputs[ERRORS - 1] = 4.0;
        assert!((output(&parameters, &inputs) - 8.0).abs() < 1e-6, "the newest error alone");
        inputs[ERRORS - 1] = -4.0;
        assert!(output(&parameters, &inputs).abs() < 1e-6, "the rectifier blocks it");
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let (mut parameters, mut tape) = (parameters(), with_inputs());
        let network = Convolution::new(&parameters);
        let output = network.forward(&mut tape, 0);
        tape.start_back();
        let d_inputs = network.backward(&mut tape, 0, output).to_vec();
        let mut gradient = vec![0.0; parameters.len()];
        Convolution::finish(&tape, &mut gradient);

        let loss = |parameters: &[f32], tape: &mut ConvolutionTape| {
            let y = Convolution::new(parameters).forward(tape, 0);
            y.zip(&y, |a, b| 0.5 * a * b).sum()
        };
        let (step, mut told) = (2e-3, 0);
        for n in (0..parameters.len()).step_by(7).chain([PARAMETERS - 1]) {
            let kept = parameters[n];
            parameters[n] = kept + step;
            let above = loss(&parameters, &mut tape);
            parameters[n] = kept - step;
            let numeric = (above - loss(&parameters, &mut tape)) / (2.0 * step);
            parameters[n] = kept;
            let tolerance = 0.05 + 0.03 * gradient[n].abs();
            assert!((numeric - gradient[n]).abs() < tolerance, "{n}: {numeric} against {}", gradient[n]);
            told += usize::from(gradient[n].abs() > 0.5);
        }
        assert!(told > 20, "only {told} gradients were large enough to tell anything");
        for (i, l) in [(0, 3), (4, 7), (9, 15)] {
            let kept = tape.inputs(0)[i][l];
            tape.inputs(0)[i][l] = kept + step;
            let above = loss(&parameters, &mut tape);
            tape.inputs(0)[i][l] = kept - step;
            let numeric = (above - loss(&parameters, &mut tape)) / (2.0 * step);
            tape.inputs(0)[i][l] = kept;
            assert!((numeric - d_inputs[i][l]).abs() < 0.05 + 0.03 * d_inputs[i][l].abs(), "input {i}");
        }
    }
}
