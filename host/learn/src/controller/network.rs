//! The residual's network for training: the same parameters in the same order as [`shared::control::network`].

use rand_chacha::ChaCha8Rng;
use shared::control::features::FEATURES;
use shared::control::network::{HIDDEN_1, HIDDEN_2, INPUTS, Network};

use crate::layers::Layers;
use engine::activation::Activation;
use engine::dense::DenseLayer;

fn layout() -> [DenseLayer; 3] {
    DenseLayer::layout([(INPUTS, HIDDEN_1), (HIDDEN_1, HIDDEN_2), (HIDDEN_2, 1)]).0
}

/// The network of a parameter vector over lanes.
pub(super) fn lane_network(parameters: &[f32]) -> Layers {
    Layers::new(&layout(), Activation::Softsign, parameters)
}

/// The chip's network of a parameter vector.
///
/// # Panics
/// If the number of parameters is not [`Network::PARAMETERS`].
pub fn chip_network(parameters: &[f32]) -> Network {
    assert_eq!(parameters.len(), Network::PARAMETERS, "parameters of another shape");
    let mut network = Network::zero();
    for (weight, value) in network.parameters_mut().zip(parameters) {
        *weight = *value;
    }
    network
}

/// A parameter vector to start training from: random hidden layers and a zero output layer, so that the controller
/// starts as its PID. What earlier breaths taught has no weight yet.
pub fn initial_parameters(rng: &mut ChaCha8Rng) -> Vec<f32> {
    let mut parameters = vec![0.0; Network::PARAMETERS];
    let [first, second, _] = layout();
    let ([forgetful], length) = DenseLayer::layout([(FEATURES, HIDDEN_1)]);
    let mut drawn = vec![0.0; length];
    forgetful.initialise(&mut drawn, 1.0, rng);
    let rows = first.slice_mut(&mut parameters).chunks_exact_mut(INPUTS);
    for (row, drawn) in rows.zip(drawn.chunks_exact(FEATURES)).take(HIDDEN_1) {
        row[..FEATURES].copy_from_slice(drawn);
    }
    second.initialise(&mut parameters, 1.0, rng);
    parameters
}

/// Zeroes the weights of features in a parameter vector or a gradient: while they stay zero, the network does not use
/// these features.
///
/// # Panics
/// If a feature does not exist.
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
    use crate::layers::LayersTape;
    use engine::Lane;
    use rand_chacha::rand_core::SeedableRng;

    fn parameters() -> Vec<f32> {
        let mut parameters = initial_parameters(&mut ChaCha8Rng::seed_from_u64(9));
        for (n, p) in parameters.iter_mut().enumerate() {
            *p += 0.1 * (n as f32).sin();
        }
        parameters
    }

    fn with_features() -> LayersTape {
        let mut tape = lane_network(&parameters()).tape(1);
        for (i, lane) in tape.inputs(0).iter_mut().enumerate() {
            *lane = Lane::from_fn(|l| ((i * 3 + l) as f32).cos());
        }
        tape
    }

    #[test]
    fn lanes_and_chip_agree() {
        let (parameters, mut tape) = (parameters(), with_features());
        let output = lane_network(&parameters).forward(&mut tape, 0);
        for l in 0..engine::LANES {
            let features = std::array::from_fn(|i| tape.inputs(0)[i][l]);
            let chip = chip_network(&parameters).forward(&features);
            assert!((chip - output[l]).abs() < 1e-5, "{chip} against {}", output[l]);
        }
    }

    #[test]
    fn a_network_that_is_blind_to_a_feature_does_not_see_it_but_sees_all_others() {
        let (mut parameters, mut tape) = (parameters(), with_features());
        blind_to(&[3, 9], &mut parameters);
        let network = lane_network(&parameters);
        let output = network.forward(&mut tape, 0);
        let d_features = network.backward(&mut tape, 0, Lane::splat(1.0)).to_vec();
        for (feature, gradient) in d_features.iter().enumerate() {
            assert_eq!(*gradient == Lane::ZERO, [3, 9].contains(&feature), "feature {feature}");
        }
        tape.inputs(0)[9] = Lane::splat(100.0);
        assert_eq!(network.forward(&mut tape, 0), output);
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let (mut parameters, mut tape) = (parameters(), with_features());
        let network = lane_network(&parameters);
        let output = network.forward(&mut tape, 0);
        let d_features = network.backward(&mut tape, 0, output).to_vec();
        let mut gradient = vec![0.0; parameters.len()];
        network.finish(&tape, &mut gradient);

        let loss = |parameters: &[f32], tape: &mut LayersTape| {
            let y = lane_network(parameters).forward(tape, 0);
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
            let kept = tape.inputs(0)[i][l];
            tape.inputs(0)[i][l] = kept + step;
            let above = loss(&parameters, &mut tape);
            tape.inputs(0)[i][l] = kept - step;
            let numeric = (above - loss(&parameters, &mut tape)) / (2.0 * step);
            tape.inputs(0)[i][l] = kept;
            assert!((numeric - d_features[i][l]).abs() < 0.02, "feature {i}");
        }
    }
}
