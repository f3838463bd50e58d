//! Ranges of numbers, from which a seed draws.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use shared::checksum::fnv;

pub use ::bench::share;

/// Standard deviations to which a normal distribution is limited.
const MOST_DEVIATIONS: f64 = 3.0;

/// Distribution of a number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Range {
    /// Lowest and highest of equally likely values.
    Uniform(f64, f64),
    /// Lowest and highest of values whose logarithms are equally likely.
    LogUniform(f64, f64),
    /// Mean and standard deviation; values further than three of these from the mean are moved there.
    Normal(f64, f64),
}

impl Range {
    /// Lowest and highest value; none for a range without any.
    pub fn ends(self) -> Option<(f64, f64)> {
        let (low, high) = match self {
            Self::Uniform(low, high) => (low, high),
            Self::LogUniform(low, high) => (if low > 0.0 { low } else { f64::NAN }, high),
            Self::Normal(mean, sd) => (mean - MOST_DEVIATIONS * sd, mean + MOST_DEVIATIONS * sd),
        };
        (low <= high && high.is_finite() && low.is_finite()).then_some((low, high))
    }

    /// Draws a number.
    pub fn draw(self, rng: &mut ChaCha8Rng) -> f64 {
        match self {
            Self::Normal(mean, sd) => {
                let deviations: f64 = StandardNormal.sample(rng);
                mean + sd * deviations.clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
            }
            Self::Uniform(low, high) => low + share(rng) * (high - low),
            Self::LogUniform(low, high) => low * (high / low).powf(share(rng)),
        }
    }
}

/// The generator of a number with this name, for the draw with this number, from 0, of those that a seed gives: a change of one range
/// leaves all other draws as they were.
pub fn stream(seed: u64, name: &str, number: u32) -> ChaCha8Rng {
    let words: Vec<u32> = name.bytes().map(u32::from).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(u64::from(fnv(&words)) << 32 | u64::from(number));
    rng
}
