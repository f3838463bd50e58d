//! A multilayer perceptron over groups of [`LANES`](engine::LANES) samples: tanh in the hidden layers, linear output.

use rand_chacha::ChaCha8Rng;

use engine::Lane;
use engine::dense::{DenseLayer, DenseWeights};

/// Shape of a network: units of each layer, inputs first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mlp {
    widths: Vec<usize>,
}

/// A network with its parameters, ready to run.
#[derive(Clone, Debug)]
pub struct Weights {
    layers: Vec<DenseWeights>,
}

/// Values of every layer, and the gradients with respect to them, for some groups of samples.
#[derive(Clone, Debug)]
pub struct MlpTape {
    widths: Vec<usize>,
    values: Vec<Vec<Lane>>,
    gradients: Vec<Vec<Lane>>,
}

/// A network for one group of samples at a time.
#[derive(Clone, Debug)]
pub struct Single {
    weights: Weights,
    tape: MlpTape,
}

impl Mlp {
    /// A network with these numbers of units per layer, inputs first, outputs last.
    ///
    /// # Panics
    /// With fewer than two layers or one that is empty.
    pub fn new(widths: &[usize]) -> Self {
        assert!(widths.len() >= 2 && !widths.contains(&0), "a network has inputs and outputs");
        Self { widths: widths.to_vec() }
    }

    /// A network with these hidden layers between inputs and outputs.
    pub fn with_hidden(inputs: usize, hidden: &[usize], outputs: usize) -> Self {
        Self::new(&[&[inputs], hidden, &[outputs]].concat())
    }

    fn layers(&self) -> impl Iterator<Item = DenseLayer> + '_ {
        let mut offset = 0;
        self.widths.windows(2).map(move |pair| {
            let layer = DenseLayer { inputs: pair[0], outputs: pair[1], offset };
            offset += layer.parameters();
            layer
        })
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.layers().map(|layer| layer.parameters()).sum()
    }

    /// Draws initial parameters; `output_gain` scales those of the output layer.
    pub fn initialise(&self, output_gain: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let mut parameters = vec![0.0; self.parameters()];
        let last = self.widths.len() - 2;
        for (n, layer) in self.layers().enumerate() {
            layer.initialise(&mut parameters, if n == last { output_gain } else { 1.0 }, rng);
        }
        parameters
    }

    /// The network of a parameter vector; further entries are ignored.
    pub fn load(&self, parameters: &[f32]) -> Weights {
        Weights { layers: self.layers().map(|layer| layer.load(parameters)).collect() }
    }

    /// The network with memory for one group of samples.
    pub fn single(&self, parameters: &[f32]) -> Single {
        Single { weights: self.load(parameters), tape: MlpTape::new(self, 1) }
    }
}

impl Single {
    /// Outputs for these inputs.
    pub fn outputs(&mut self, inputs: &[Lane]) -> &[Lane] {
        self.tape.inputs(0).copy_from_slice(inputs);
        self.weights.forward(&mut self.tape);
        self.tape.outputs(0)
    }
}

impl MlpTape {
    /// Memory for `groups` groups of samples.
    pub fn new(network: &Mlp, groups: usize) -> Self {
        let zeros: Vec<Vec<Lane>> =
            network.widths.iter().map(|width| vec![Lane::ZERO; groups * width]).collect();
        Self { widths: network.widths.clone(), gradients: zeros.clone(), values: zeros }
    }

    /// Mutable access to the inputs of a group.
    pub fn inputs(&mut self, group: usize) -> &mut [Lane] {
        let width = self.widths[0];
        &mut self.values[0][group * width..(group + 1) * width]
    }

    /// Outputs of a group.
    pub fn outputs(&self, group: usize) -> &[Lane] {
        let last = self.widths.len() - 1;
        &self.values[last][group * self.widths[last]..(group + 1) * self.widths[last]]
    }

    /// Mutable access to the gradient with respect to the outputs of a group.
    pub fn d_outputs(&mut self, group: usize) -> &mut [Lane] {
        let last = self.widths.len() - 1;
        &mut self.gradients[last][group * self.widths[last]..(group + 1) * self.widths[last]]
    }
}

impl Weights {
    /// Computes the outputs of every group from its inputs.
    pub fn forward(&self, tape: &mut MlpTape) {
        let last = self.layers.len() - 1;
        for (n, layer) in self.layers.iter().enumerate() {
            let (before, after) = tape.values.split_at_mut(n + 1);
            let inputs = before[n].chunks_exact(tape.widths[n]);
            for (x, y) in inputs.zip(after[0].chunks_exact_mut(tape.widths[n + 1])) {
                layer.forward(x, y);
            }
            if n < last {
                after[0].iter_mut().for_each(|lane| *lane = lane.map(tanh));
            }
        }
    }

    /// Adds the gradient with respect to the parameters, given that with respect to the outputs.
    pub fn backward(&self, tape: &mut MlpTape, gradient: &mut [f32]) {
        for (n, layer) in self.layers.iter().enumerate().rev() {
            let (before, after) = tape.gradients.split_at_mut(n + 1);
            layer.shape().gradient(&after[0], &tape.values[n], gradient);
            if n == 0 {
                break;
            }
            before[n].fill(Lane::ZERO);
            let outputs = after[0].chunks_exact(tape.widths[n + 1]);
            for (dy, dx) in outputs.zip(before[n].chunks_exact_mut(tape.widths[n])) {
                layer.backward(dy, dx);
            }
            for (d, y) in before[n].iter_mut().zip(&tape.values[n]) {
                *d = d.zip(y, |d, y| d * (1.0 - y * y));
            }
        }
    }
}

/// Argument at which the fraction of [`tanh`] reaches one.
const TANH_LIMIT: f32 = 4.96;

/// Hyperbolic tangent by Lambert's continued fraction, to within 2e-4: plain arithmetic that the compiler vectorises,
/// where the platform's function would take most of the training time.
fn tanh(x: f32) -> f32 {
    let x = x.clamp(-TANH_LIMIT, TANH_LIMIT);
    let s = x * x;
    let numerator = x * (135_135.0 + s * (17_325.0 + s * (378.0 + s)));
    numerator / (135_135.0 + s * (62_370.0 + s * (3_150.0 + 28.0 * s)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn the_tangent_is_close_to_the_true_one_and_bounded() {
        for n in -1000..=1000 {
            let x = n as f32 * 0.01;
            assert!((tanh(x) - x.tanh()).abs() < 2e-4, "at {x}");
            assert!(tanh(x).abs() <= 1.0, "at {x}");
        }
    }

    const GROUPS: usize = 3;

    fn weight(group: usize, output: usize, l: usize) -> f32 {
        ((group * 31 + output * 17 + l * 7) as f32).cos()
    }

    /// Tape after a forward pass on fixed inputs.
    fn forward(network: &Mlp, parameters: &[f32]) -> MlpTape {
        let mut tape = MlpTape::new(network, GROUPS);
        for group in 0..GROUPS {
            for (i, lane) in tape.inputs(group).iter_mut().enumerate() {
                *lane = Lane::from_fn(|l| ((group * 5 + i * 3 + l) as f32).sin());
            }
        }
        network.load(parameters).forward(&mut tape);
        tape
    }

    /// Sum of all outputs, each with its own weight.
    fn loss(network: &Mlp, parameters: &[f32]) -> f64 {
        let tape = forward(network, parameters);
        let of = |group: usize, output: usize, lane: &Lane| -> f64 {
            lane.0.iter().enumerate().map(|(l, y)| f64::from(weight(group, output, l) * y)).sum()
        };
        (0..GROUPS)
            .flat_map(|group| tape.outputs(group).iter().enumerate().map(move |(o, lane)| of(group, o, lane)))
            .sum()
    }

    #[test]
    fn the_gradient_agrees_with_finite_differences() {
        for widths in [vec![4, 9, 7, 2], vec![5, 64, 64, 2], vec![3, 16, 1]] {
            check_gradient(&Mlp::new(&widths));
        }
    }

    fn check_gradient(network: &Mlp) {
        let mut parameters = network.initialise(1.0, &mut ChaCha8Rng::seed_from_u64(5));
        let mut tape = forward(network, &parameters);
        for group in 0..GROUPS {
            for (o, d) in tape.d_outputs(group).iter_mut().enumerate() {
                *d = Lane::from_fn(|l| weight(group, o, l));
            }
        }
        let mut gradient = vec![0.0; parameters.len()];
        network.load(&parameters).backward(&mut tape, &mut gradient);

        let step = 1e-2;
        for n in (0..parameters.len()).step_by((parameters.len() / 300).max(1)) {
            let kept = parameters[n];
            parameters[n] = kept + step;
            let above = loss(network, &parameters);
            parameters[n] = kept - step;
            let numeric = (above - loss(network, &parameters)) / f64::from(2.0 * step);
            parameters[n] = kept;
            let tolerance = 0.01 * (1.0 + f64::from(gradient[n].abs()));
            assert!((numeric - f64::from(gradient[n])).abs() < tolerance, "parameter {n}: {numeric}");
        }
    }

    #[test]
    fn groups_do_not_mix() {
        let network = Mlp::with_hidden(2, &[5], 1);
        let parameters = network.initialise(1.0, &mut ChaCha8Rng::seed_from_u64(1));
        let together = forward(&network, &parameters);
        let mut alone = MlpTape::new(&network, 1);
        let mut copy = together.clone();
        alone.inputs(0).copy_from_slice(copy.inputs(2));
        network.load(&parameters).forward(&mut alone);
        assert_eq!(alone.outputs(0), together.outputs(2));
    }
}
