//! Random numbers with the same bits on every platform: streams of `ChaCha`, and the normal distribution by the ziggurat of Marsaglia
//! and Tsang (2000).
//!
//! A library's sampler would take the logarithm and the exponential of the tail from the platform.

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};

use crate::math::{exp, ln};

/// Strips of equal area under the density: all but the lowest are rectangles.
const STRIPS: usize = 256;
/// Where the tail begins, in standard deviations, and the area of each strip, for this number of strips.
const TAIL: f64 = 3.654_152_885_361_009;
const AREA: f64 = 0.004_928_673_233_99;

/// Random numbers of this `number`: parts with streams of their own do not affect each other's draws.
pub(crate) fn stream(seed: u64, number: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(number);
    rng
}

/// An equally likely number from 0 to 1, without 1.
pub fn share(rng: &mut impl Rng) -> f64 {
    const UNIT: f64 = 1.0 / (1_u64 << 53) as f64;
    (rng.next_u64() >> 11) as f64 * UNIT
}

/// A number of the exponential distribution with mean 1.
pub(crate) fn exponential(rng: &mut impl Rng) -> f64 {
    // Never the logarithm of zero.
    -ln(1.0 - share(rng))
}

/// A number of the normal distribution with mean 0 and standard deviation 1.
#[inline]
pub(crate) fn normal(rng: &mut impl Rng) -> f64 {
    loop {
        let bits = rng.next_u64();
        // Eight bits choose the strip, 52 others the place in it: from -1 to 1.
        let strip = (bits & 0xff) as usize;
        let place = f64::from_bits((bits >> 12) | 0x4000_0000_0000_0000) - 3.0;
        let x = place * EDGES[strip];
        if x.abs() < EDGES[strip + 1] {
            return x;
        }
        if strip == 0 {
            return tail(rng, place);
        }
        let (low, high) = (DENSITIES[strip], DENSITIES[strip + 1]);
        if high + (low - high) * share(rng) < exp(-0.5 * x * x) {
            return x;
        }
    }
}

/// A number beyond the beginning of the tail, on the side of `place`.
#[cold]
fn tail(rng: &mut impl Rng, place: f64) -> f64 {
    loop {
        let beyond = exponential(rng) / TAIL;
        if 2.0 * exponential(rng) >= beyond * beyond {
            return if place < 0.0 { -(TAIL + beyond) } else { TAIL + beyond };
        }
    }
}

/// Right edges of the strips, from the lowest up; that of the lowest is where a rectangle of its area would end.
static EDGES: [f64; STRIPS + 1] = edges();
/// The density, 1 at its highest, at each edge.
static DENSITIES: [f64; STRIPS + 1] = densities();

const fn edges() -> [f64; STRIPS + 1] {
    let mut edges = [0.0; STRIPS + 1];
    edges[0] = AREA / tabulated::density(TAIL);
    edges[1] = TAIL;
    let mut strip = 2;
    while strip < STRIPS {
        let before = edges[strip - 1];
        edges[strip] = tabulated::edge_at(AREA / before + tabulated::density(before));
        strip += 1;
    }
    edges
}

const fn densities() -> [f64; STRIPS + 1] {
    let (edges, mut densities) = (edges(), [1.0; STRIPS + 1]);
    let mut strip = 0;
    while strip < STRIPS {
        densities[strip] = tabulated::density(edges[strip]);
        strip += 1;
    }
    densities
}

/// Functions for the tables, which the compiler computes.
mod tabulated {
    /// The normal density, 1 at its highest: `exp(-x^2 / 2)` by halving and a series.
    pub(super) const fn density(x: f64) -> f64 {
        const HALVINGS: u32 = 8;
        let exponent = -0.5 * x * x / (1_u32 << HALVINGS) as f64;
        let (mut term, mut sum, mut n) = (1.0, 1.0, 1.0);
        while n < 16.0 {
            term *= exponent / n;
            sum += term;
            n += 1.0;
        }
        let mut halving = 0;
        while halving < HALVINGS {
            sum *= sum;
            halving += 1;
        }
        sum
    }

    /// The `x` above zero at which the density has this value, by Newton's method from above the middle.
    pub(super) const fn edge_at(value: f64) -> f64 {
        let (mut x, mut round) = (1.0, 0);
        while round < 60 {
            let found = density(x);
            x += (found - value) / (x * found);
            // A step beyond the tail's end would not return.
            x = x.clamp(0.01, 4.0);
            round += 1;
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn the_numbers_are_those_of_the_library_but_for_the_last_bits() {
        let (mut ours, mut theirs) = (stream(3, 7), stream(3, 7));
        let mut in_tail = 0;
        for n in 0..200_000 {
            let expected: f64 = StandardNormal.sample(&mut theirs);
            let found = normal(&mut ours);
            if expected.abs() > TAIL {
                // Its draws differ from here on.
                in_tail += 1;
                assert!(found.abs() > TAIL, "{n}");
                (ours, theirs) = (stream(n, 7), stream(n, 7));
            } else {
                assert!((found - expected).abs() < 1e-12, "{n}: {found} {expected}");
            }
        }
        assert!(in_tail > 20, "{in_tail}");
    }

    #[test]
    fn the_tail_is_as_heavy_as_it_should_be() {
        let mut rng = stream(1, 0);
        let far: Vec<f64> = (0..20_000).map(|_| tail(&mut rng, 1.0)).collect();
        // From the normal distribution function.
        for (beyond, expected) in [(4.0, 0.245_5), (4.5, 0.026_3)] {
            let share = far.iter().filter(|x| **x > beyond).count() as f64 / far.len() as f64;
            assert!((share - expected).abs() < 0.015, "{share} beyond {beyond}");
        }
    }

    #[test]
    fn exponential_numbers_have_mean_and_spread_of_one() {
        let mut rng = stream(2, 0);
        let drawn: Vec<f64> = (0..40_000).map(|_| exponential(&mut rng)).collect();
        let mean = drawn.iter().sum::<f64>() / drawn.len() as f64;
        let spread = drawn.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / drawn.len() as f64;
        assert!((mean - 1.0).abs() < 0.025 && (spread - 1.0).abs() < 0.1, "{mean} {spread}");
    }
}
