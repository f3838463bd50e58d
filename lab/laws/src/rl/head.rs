//! Meaning of a policy's outputs: a Gaussian with a state-independent spread, or a categorical distribution.
//!
//! The outputs of a group of samples are lanes. Gradients are those of a loss that falls with the weighted log
//! probability and with the entropy.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::Actions;
use engine::{LANES, Lane};

/// `ln(2 pi) / 2`.
const HALF_LN_2_PI: f32 = 0.918_938_5;

/// A distribution over actions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Head {
    /// One output: the mean. The logarithm of the standard deviation is a separate parameter.
    Gaussian {
        /// Logarithm of the standard deviation.
        log_sd: f32,
    },
    /// One output per choice: its unnormalised log probability.
    Categorical,
}

/// Gradients of a loss with respect to the distribution's quantities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slope {
    /// Gradient with respect to the log probability of the action, per sample.
    pub log_probability: Lane,
    /// Gradient with respect to the entropy, the same for every sample.
    pub entropy: f32,
}

impl Head {
    /// Number of network outputs for these actions.
    pub fn outputs(actions: Actions) -> usize {
        match actions {
            Actions::Continuous => 1,
            Actions::Discrete(choices) => choices,
        }
    }

    /// Draws an action for every sample.
    pub fn sample(self, outputs: &[Lane], rng: &mut ChaCha8Rng) -> Lane {
        match self {
            Self::Gaussian { log_sd } => {
                let sd = log_sd.exp();
                outputs[0].map(|mean| mean + sd * rng.sample::<f32, _>(StandardNormal))
            }
            Self::Categorical => {
                let probabilities = softmax(outputs);
                Lane::from_fn(|l| {
                    let mut left: f32 = rng.random();
                    let chosen = probabilities.iter().position(|p| {
                        left -= p[l];
                        left < 0.0
                    });
                    chosen.unwrap_or(outputs.len() - 1) as f32
                })
            }
        }
    }

    /// Log probability (density) of each action.
    pub fn log_probability(self, outputs: &[Lane], actions: &Lane) -> Lane {
        match self {
            Self::Gaussian { log_sd } => {
                let precision = (-log_sd).exp();
                actions.zip(&outputs[0], |action, mean| {
                    let z = (action - mean) * precision;
                    -0.5 * z * z - log_sd - HALF_LN_2_PI
                })
            }
            Self::Categorical => {
                let probabilities = softmax(outputs);
                Lane::from_fn(|l| logarithm(probabilities[actions[l] as usize][l]))
            }
        }
    }

    /// Writes the gradient with respect to the outputs; returns that with respect to the logarithm of the standard
    /// deviation, summed over the samples (zero for the categorical distribution).
    pub fn backward(self, outputs: &[Lane], actions: &Lane, slope: &Slope, d_outputs: &mut [Lane]) -> f32 {
        match self {
            Self::Gaussian { log_sd } => {
                let precision = (-log_sd).exp();
                let z = actions.zip(&outputs[0], |action, mean| (action - mean) * precision);
                d_outputs[0] = slope.log_probability.zip(&z, |d, z| d * z * precision);
                slope.log_probability.zip(&z, |d, z| d * (z * z - 1.0)).sum() + slope.entropy * LANES as f32
            }
            Self::Categorical => {
                let probabilities = softmax(outputs);
                let entropy = entropy_of(&probabilities);
                for (choice, (d, p)) in d_outputs.iter_mut().zip(&probabilities).enumerate() {
                    *d = Lane::from_fn(|l| {
                        let chosen = f32::from(u8::from(actions[l] as usize == choice));
                        let by_entropy = -p[l] * (logarithm(p[l]) + entropy[l]);
                        slope.log_probability[l] * (chosen - p[l]) + slope.entropy * by_entropy
                    });
                }
                0.0
            }
        }
    }
}

/// Logarithm that stays finite at zero.
fn logarithm(p: f32) -> f32 {
    p.max(f32::MIN_POSITIVE).ln()
}

fn entropy_of(probabilities: &[Lane]) -> Lane {
    Lane::from_fn(|l| -probabilities.iter().map(|p| p[l] * logarithm(p[l])).sum::<f32>())
}

fn softmax(outputs: &[Lane]) -> Vec<Lane> {
    let highest = outputs[1..].iter().fold(outputs[0], |highest, y| highest.zip(y, f32::max));
    let mut powers: Vec<Lane> = outputs.iter().map(|y| y.zip(&highest, |y, h| (y - h).exp())).collect();
    let total = powers.iter().fold(Lane::ZERO, |total, power| total.zip(power, |a, b| a + b));
    for power in &mut powers {
        *power = power.zip(&total, |power, total| power / total);
    }
    powers
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    fn outputs(choices: usize) -> Vec<Lane> {
        (0..choices).map(|n| Lane::from_fn(|l| ((3 * n + l) as f32).sin())).collect()
    }

    fn weights() -> Slope {
        Slope { log_probability: Lane::from_fn(|l| (l as f32).cos()), entropy: 0.3 }
    }

    /// The loss whose gradient [`Head::backward`] computes with [`weights`].
    fn loss(head: Head, outputs: &[Lane], actions: &Lane) -> f32 {
        let slope = weights();
        let log = head.log_probability(outputs, actions).zip(&slope.log_probability, |a, b| a * b).sum();
        let entropy = match head {
            Head::Gaussian { log_sd } => log_sd * LANES as f32,
            Head::Categorical => entropy_of(&softmax(outputs)).sum(),
        };
        log + slope.entropy * entropy
    }

    #[test]
    fn gradients_by_outputs_agree_with_finite_differences() {
        let gaussian = (Head::Gaussian { log_sd: -0.4 }, 1, Lane::from_fn(|l| 0.2 * l as f32 - 1.0));
        let categorical = (Head::Categorical, 4, Lane::from_fn(|l| (l % 4) as f32));
        for (head, choices, actions) in [gaussian, categorical] {
            let mut outputs = outputs(choices);
            let mut d = vec![Lane::ZERO; choices];
            head.backward(&outputs, &actions, &weights(), &mut d);
            for (n, l) in (0..choices).flat_map(|n| (0..LANES).map(move |l| (n, l))) {
                let (kept, step) = (outputs[n][l], 2e-2);
                outputs[n][l] = kept + step;
                let above = loss(head, &outputs, &actions);
                outputs[n][l] = kept - step;
                let numeric = (above - loss(head, &outputs, &actions)) / (2.0 * step);
                outputs[n][l] = kept;
                assert!((numeric - d[n][l]).abs() < 5e-3, "{head:?} {n} {l}: {numeric} {}", d[n][l]);
            }
        }
    }

    #[test]
    fn the_gradient_by_the_spread_agrees_with_finite_differences() {
        let (outputs, actions) = (outputs(1), Lane::from_fn(|l| 0.1 * l as f32));
        let at = |log_sd| loss(Head::Gaussian { log_sd }, &outputs, &actions);
        let numeric = (at(-0.39) - at(-0.41)) / 0.02;
        let head = Head::Gaussian { log_sd: -0.4 };
        let analytic = head.backward(&outputs, &actions, &weights(), &mut [Lane::ZERO]);
        assert!((numeric - analytic).abs() < 1e-2 * (1.0 + analytic.abs()), "{numeric} {analytic}");
    }

    #[test]
    fn choices_are_drawn_as_often_as_they_are_probable() {
        let outputs = [0.2_f32, 0.5, 0.3].map(|p| Lane::splat(p.ln()));
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut counts = [0.0_f64; 3];
        for _ in 0..1000 {
            for action in Head::Categorical.sample(&outputs, &mut rng).0 {
                counts[action as usize] += 1.0 / 16_000.0;
            }
        }
        for (count, p) in counts.iter().zip([0.2, 0.5, 0.3]) {
            assert!((count - p).abs() < 0.015, "{counts:?}");
        }
    }

    #[test]
    fn an_impossible_choice_has_a_finite_logarithm() {
        let outputs = [Lane::splat(-500.0), Lane::splat(500.0)];
        let log = Head::Categorical.log_probability(&outputs, &Lane::ZERO);
        assert!(log.0.iter().all(|log| log.is_finite()));
    }
}
