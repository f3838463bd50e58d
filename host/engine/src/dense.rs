//! A fully connected layer over lanes: `y = W x + b`, with forward pass, backward pass and gradient.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Uniform};

use super::Lane;
use super::lane::{Start, multiply, outer_add};

/// Number of steps whose gradient is summed at once: few enough to stay in the first-level cache.
const CHUNK: usize = 16;

/// The input of a bias at each of these steps.
static ONES: [Lane; CHUNK] = [Lane::splat(1.0); CHUNK];

/// Shape of a layer, and position of its parameters within a flat parameter vector: weights row by row (one row per
/// output), then biases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DenseLayer {
    /// Number of inputs.
    pub inputs: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Index of the first parameter.
    pub offset: usize,
}

/// Parameters of a layer, ready for the forward and backward pass.
#[derive(Clone, Debug)]
pub struct DenseWeights {
    shape: DenseLayer,
    /// `[outputs][inputs]`: for the backward pass.
    by_output: Vec<f32>,
    /// `[inputs][outputs]`: for the forward pass.
    by_input: Vec<f32>,
    bias: Vec<f32>,
}

impl DenseLayer {
    /// Lays out layers one after the other, each given as `(inputs, outputs)`. Returns the layers and the total length.
    pub fn layout<const N: usize>(shapes: [(usize, usize); N]) -> ([Self; N], usize) {
        let mut offset = 0;
        let layers = shapes.map(|(inputs, outputs)| {
            let layer = Self { inputs, outputs, offset };
            offset += layer.parameters();
            layer
        });
        (layers, offset)
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        (self.inputs + 1) * self.outputs
    }

    /// Draws weights uniformly, scaled by `gain / sqrt(inputs)`; biases are zero.
    pub fn initialise(&self, parameters: &mut [f32], gain: f32, rng: &mut ChaCha8Rng) {
        let bound = gain * (3.0 / self.inputs as f32).sqrt();
        let (weights, bias) = self.slice_mut(parameters).split_at_mut(self.inputs * self.outputs);
        match Uniform::new(-bound, bound) {
            Ok(uniform) => weights.iter_mut().for_each(|w| *w = uniform.sample(rng)),
            Err(_) => weights.fill(0.0),
        }
        bias.fill(0.0);
    }

    /// This layer's part of the parameter vector.
    pub fn slice<'a>(&self, parameters: &'a [f32]) -> &'a [f32] {
        &parameters[self.offset..self.offset + self.parameters()]
    }

    /// Mutable access to this layer's part of the parameter vector.
    pub fn slice_mut<'a>(&self, parameters: &'a mut [f32]) -> &'a mut [f32] {
        &mut parameters[self.offset..self.offset + self.parameters()]
    }

    /// Loads this layer's parameters from the vector.
    pub fn load(&self, parameters: &[f32]) -> DenseWeights {
        let (by_output, bias) = self.slice(parameters).split_at(self.inputs * self.outputs);
        let by_input =
            (0..self.inputs).flat_map(|i| by_output.iter().skip(i).step_by(self.inputs)).copied().collect();
        DenseWeights { shape: *self, by_output: by_output.to_vec(), by_input, bias: bias.to_vec() }
    }

    /// Adds the gradient with respect to the parameters, summed over rollouts and steps.
    ///
    /// Shapes: `dy` steps times outputs, `x` steps times inputs.
    pub fn gradient(&self, dy: &[Lane], x: &[Lane], gradient: &mut [f32]) {
        let (weights, bias) = self.slice_mut(gradient).split_at_mut(self.inputs * self.outputs);
        let chunks = dy.chunks(CHUNK * self.outputs).zip(x.chunks(CHUNK * self.inputs));
        for (dy, x) in chunks {
            outer_add(dy, x, self.outputs, self.inputs, weights);
            outer_add(dy, &ONES[..dy.len() / self.outputs], self.outputs, 1, bias);
        }
    }
}

impl DenseWeights {
    /// `y = W x + b`.
    pub fn forward(&self, x: &[Lane], y: &mut [Lane]) {
        multiply(Start::Bias(&self.bias), &self.by_input, x, y);
    }

    /// `dx = W^T dy`.
    pub fn backward(&self, dy: &[Lane], dx: &mut [Lane]) {
        multiply(Start::Zero, &self.by_output, dy, dx);
    }

    /// `dx += W^T dy`.
    pub fn backward_add(&self, dy: &[Lane], dx: &mut [Lane]) {
        multiply(Start::Outputs, &self.by_output, dy, dx);
    }

    /// Shape of the layer.
    pub fn shape(&self) -> &DenseLayer {
        &self.shape
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    /// A scalar function of a layer's output: `sum of y^2 / 2`, so that `dy = y`.
    fn loss(layer: &DenseLayer, parameters: &[f32], x: &[Lane]) -> f32 {
        let mut y = vec![Lane::ZERO; layer.outputs];
        layer.load(parameters).forward(x, &mut y);
        y.iter().map(|y| y.zip(y, |a, b| 0.5 * a * b).sum()).sum()
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let ([_, layer], total) = DenseLayer::layout([(2, 3), (5, 9)]);
        let mut parameters = vec![0.0; total];
        layer.initialise(&mut parameters, 1.0, &mut rng);
        let mut x: Vec<Lane> = (0..5).map(|i| Lane::from_fn(|l| ((i * 5 + l) as f32).sin())).collect();

        let weights = layer.load(&parameters);
        let mut y = vec![Lane::ZERO; layer.outputs];
        weights.forward(&x, &mut y);
        let (mut dx, mut gradient) = (vec![Lane::ZERO; layer.inputs], vec![0.0; total]);
        weights.backward(&y, &mut dx);
        layer.gradient(&y, &x, &mut gradient);

        let step = 1e-2;
        for n in 0..total {
            let kept = parameters[n];
            parameters[n] = kept + step;
            let above = loss(&layer, &parameters, &x);
            parameters[n] = kept - step;
            let numeric = (above - loss(&layer, &parameters, &x)) / (2.0 * step);
            parameters[n] = kept;
            assert!((numeric - gradient[n]).abs() < 0.02 * (1.0 + gradient[n].abs()), "parameter {n}");
        }
        for (i, l) in [(0, 0), (3, 15), (4, 7)] {
            let kept = x[i][l];
            x[i][l] = kept + step;
            let above = loss(&layer, &parameters, &x);
            x[i][l] = kept - step;
            let numeric = (above - loss(&layer, &parameters, &x)) / (2.0 * step);
            x[i][l] = kept;
            assert!((numeric - dx[i][l]).abs() < 0.02 * (1.0 + dx[i][l].abs()), "input {i} of rollout {l}");
        }
    }
}
