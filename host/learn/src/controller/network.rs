//! The residual's network over lanes: the same numbers in the same order as [`shared::control::network`].

use shared::control::features::FEATURES;
use shared::control::network::{HIDDEN_1, HIDDEN_2, Network};

use engine::Lane;
use engine::activation::Activation;
use engine::dense::{DenseLayer, DenseWeights};

/// The network's three layers, ready for both directions.
#[derive(Clone, Debug)]
pub struct LaneNetwork {
    layers: [DenseWeights; 3],
}

/// Values and gradients of all ticks of a rollout.
#[derive(Clone, Debug)]
pub struct NetworkTape {
    features: Vec<Lane>,
    hidden_1: Vec<Lane>,
    hidden_2: Vec<Lane>,
    d_hidden_1: Vec<Lane>,
    d_hidden_2: Vec<Lane>,
    d_output: Vec<Lane>,
}

fn layout() -> [DenseLayer; 3] {
    DenseLayer::layout([(FEATURES, HIDDEN_1), (HIDDEN_1, HIDDEN_2), (HIDDEN_2, 1)]).0
}

impl NetworkTape {
    /// Memory for so many ticks.
    pub fn new(ticks: usize) -> Self {
        let zeros = |width: usize| vec![Lane::ZERO; ticks * width];
        Self {
            features: zeros(FEATURES),
            hidden_1: zeros(HIDDEN_1),
            hidden_2: zeros(HIDDEN_2),
            d_hidden_1: zeros(HIDDEN_1),
            d_hidden_2: zeros(HIDDEN_2),
            d_output: zeros(1),
        }
    }

    /// Features of a tick, to be written.
    pub fn features(&mut self, tick: usize) -> &mut [Lane] {
        &mut self.features[tick * FEATURES..(tick + 1) * FEATURES]
    }
}

impl LaneNetwork {
    /// The network of a parameter vector.
    pub fn new(parameters: &[f32]) -> Self {
        Self { layers: layout().map(|layer| layer.load(parameters)) }
    }

    /// Output of a tick whose features have been written.
    pub fn forward(&self, tape: &mut NetworkTape, tick: usize) -> Lane {
        let [first, second, output] = &self.layers;
        let features = &tape.features[tick * FEATURES..(tick + 1) * FEATURES];
        let hidden_1 = &mut tape.hidden_1[tick * HIDDEN_1..(tick + 1) * HIDDEN_1];
        first.forward(features, hidden_1);
        Activation::Softsign.forward(hidden_1);
        let hidden_2 = &mut tape.hidden_2[tick * HIDDEN_2..(tick + 1) * HIDDEN_2];
        second.forward(hidden_1, hidden_2);
        Activation::Softsign.forward(hidden_2);
        let mut y = [Lane::ZERO];
        output.forward(hidden_2, &mut y);
        y[0]
    }

    /// Gradient by a tick's features, given that by its output.
    pub fn backward(&self, tape: &mut NetworkTape, tick: usize, d_output: Lane) -> [Lane; FEATURES] {
        let [first, second, output] = &self.layers;
        tape.d_output[tick] = d_output;
        let d_hidden_2 = &mut tape.d_hidden_2[tick * HIDDEN_2..(tick + 1) * HIDDEN_2];
        output.backward(&[d_output], d_hidden_2);
        Activation::Softsign.backward(&tape.hidden_2[tick * HIDDEN_2..(tick + 1) * HIDDEN_2], d_hidden_2);
        let d_hidden_1 = &mut tape.d_hidden_1[tick * HIDDEN_1..(tick + 1) * HIDDEN_1];
        second.backward(d_hidden_2, d_hidden_1);
        Activation::Softsign.backward(&tape.hidden_1[tick * HIDDEN_1..(tick + 1) * HIDDEN_1], d_hidden_1);
        let mut d_features = [Lane::ZERO; FEATURES];
        first.backward(d_hidden_1, &mut d_features);
        d_features
    }

    /// Adds the gradient by the parameters over all ticks.
    pub fn finish(&self, tape: &NetworkTape, gradient: &mut [f32]) {
        let [first, second, output] = layout();
        first.gradient(&tape.d_hidden_1, &tape.features, gradient);
        second.gradient(&tape.d_hidden_2, &tape.hidden_1, gradient);
        output.gradient(&tape.d_output, &tape.hidden_2, gradient);
    }
}

/// The chip's network of a parameter vector.
///
/// # Panics
/// If there are not exactly [`Network::PARAMETERS`].
pub fn chip_network(parameters: &[f32]) -> Network {
    assert_eq!(parameters.len(), Network::PARAMETERS, "parameters of another shape");
    let mut network = Network::zero();
    for (weight, value) in network.parameters_mut().zip(parameters) {
        *weight = *value;
    }
    network
}

/// A parameter vector to start training from: random hidden layers, an output of zero, so that the controller
/// starts as its PID.
pub fn initial_parameters(rng: &mut rand_chacha::ChaCha8Rng) -> Vec<f32> {
    let mut parameters = vec![0.0; Network::PARAMETERS];
    let [first, second, _] = layout();
    first.initialise(&mut parameters, 1.0, rng);
    second.initialise(&mut parameters, 1.0, rng);
    parameters
}

/// Takes features out of a parameter vector, or out of a gradient: a network whose weights of a feature are zero and stay
/// zero does not see it.
///
/// # Panics
/// If there is no such feature.
pub fn blind_to(features: &[usize], parameters: &mut [f32]) {
    let [first, ..] = layout();
    for row in first.slice_mut(parameters)[..first.inputs * first.outputs].chunks_exact_mut(first.inputs) {
        for feature in features {
            row[*feature] = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    fn parameters() -> Vec<f32> {
        let mut parameters = initial_parameters(&mut ChaCha8Rng::seed_from_u64(9));
        for (n, p) in parameters.iter_mut().enumerate() {
            *p += 0.1 * (n as f32).sin();
        }
        parameters
    }

    fn with_features() -> NetworkTape {
        let mut tape = NetworkTape::new(1);
        for (i, lane) in tape.features(0).iter_mut().enumerate() {
            *lane = Lane::from_fn(|l| ((i * 3 + l) as f32).cos());
        }
        tape
    }

    #[test]
    fn lanes_and_chip_agree() {
        let (parameters, mut tape) = (parameters(), with_features());
        let output = LaneNetwork::new(&parameters).forward(&mut tape, 0);
        for l in 0..engine::LANES {
            let features = std::array::from_fn(|i| tape.features[i][l]);
            let chip = chip_network(&parameters).forward(&features);
            assert!((chip - output[l]).abs() < 1e-5, "{chip} against {}", output[l]);
        }
    }

    #[test]
    fn a_network_that_is_blind_to_a_feature_does_not_see_it_but_sees_all_others() {
        let (mut parameters, mut tape) = (parameters(), with_features());
        blind_to(&[3, 9], &mut parameters);
        let network = LaneNetwork::new(&parameters);
        let output = network.forward(&mut tape, 0);
        let d_features = network.backward(&mut tape, 0, Lane::splat(1.0));
        for (feature, gradient) in d_features.iter().enumerate() {
            assert_eq!(*gradient == Lane::ZERO, [3, 9].contains(&feature), "feature {feature}");
        }
        tape.features(0)[9] = Lane::splat(100.0);
        assert_eq!(network.forward(&mut tape, 0), output);
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let (mut parameters, mut tape) = (parameters(), with_features());
        let network = LaneNetwork::new(&parameters);
        let output = network.forward(&mut tape, 0);
        let d_features = network.backward(&mut tape, 0, output);
        let mut gradient = vec![0.0; parameters.len()];
        network.finish(&tape, &mut gradient);

        let loss = |parameters: &[f32], tape: &mut NetworkTape| {
            let y = LaneNetwork::new(parameters).forward(tape, 0);
            y.zip(&y, |a, b| 0.5 * a * b).sum()
        };
        let step = 1e-2;
        for n in (0..parameters.len()).step_by(17) {
            let kept = parameters[n];
            parameters[n] = kept + step;
            let above = loss(&parameters, &mut tape);
            parameters[n] = kept - step;
            let numeric = (above - loss(&parameters, &mut tape)) / (2.0 * step);
            parameters[n] = kept;
            assert!((numeric - gradient[n]).abs() < 0.02 + 0.02 * gradient[n].abs(), "parameter {n}");
        }
        for (i, l) in [(0, 3), (23, 15)] {
            let kept = tape.features(0)[i][l];
            tape.features(0)[i][l] = kept + step;
            let above = loss(&parameters, &mut tape);
            tape.features(0)[i][l] = kept - step;
            let numeric = (above - loss(&parameters, &mut tape)) / (2.0 * step);
            tape.features(0)[i][l] = kept;
            assert!((numeric - d_features[i][l]).abs() < 0.02, "feature {i}");
        }
    }
}
