//! Powers and logarithms of floats. Each is computed in doubles from additions, multiplications and one division, whose results IEEE
//! 754 defines exactly: the bits are the same on every machine, where those of a platform's functions are not. Without branches, so
//! that a loop over a lane becomes vector operations.
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use std::f64::consts::{FRAC_1_SQRT_2, LN_2, LOG2_E};

/// Number of bits of a double's fraction, and the value of its exponent's bits at one.
const FRACTION_BITS: u32 = 52;
const BIAS: u64 = 1023;
/// Added to a double, it leaves the nearest whole number in the lowest bits.
const ROUND: f64 = 1.5 * (1_u64 << FRACTION_BITS) as f64;
/// Exponents beyond which the result is zero or infinite as a float.
const EXPONENTS: (f64, f64) = (-1000.0, 1000.0);

/// `e^x`.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    exp2(f64::from(x) * LOG2_E)
}

/// Natural logarithm of a finite positive number; NaN of one that is not positive.
#[inline(always)]
pub fn ln(x: f32) -> f32 {
    if x > 0.0 { (log2(x) * LN_2) as f32 } else { f32::NAN }
}

/// `x^exponent` of a positive number; NaN of any other one.
#[inline(always)]
pub fn pow(x: f32, exponent: f32) -> f32 {
    let power = exp2(f64::from(exponent) * log2(x));
    if x > 0.0 { power } else { f32::NAN }
}

/// `2^x`: that of the nearest whole number by its bits, that of the rest by its series.
#[inline(always)]
fn exp2(x: f64) -> f32 {
    let x = x.clamp(EXPONENTS.0, EXPONENTS.1);
    let shifted = x + ROUND;
    let rest = (x - (shifted - ROUND)) * LN_2;
    let whole = f64::from_bits((shifted.to_bits().wrapping_add(BIAS)) << FRACTION_BITS);
    // 1 / n! from n = 10 down to 0; the next term is below 3e-13.
    let series = [3_628_800.0, 362_880.0, 40_320.0, 5040.0, 720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0];
    (whole * series.iter().fold(0.0, |sum, factorial| sum * rest + 1.0 / factorial)) as f32
}

/// Logarithm to base 2: of `m 2^n` with `m` around one, `n` and the series of `2 artanh((m - 1) / (m + 1))`.
#[inline(always)]
fn log2(x: f32) -> f64 {
    let least = FRAC_1_SQRT_2.to_bits();
    let shifted = f64::from(x).to_bits().wrapping_sub(least).wrapping_add(BIAS << FRACTION_BITS);
    let exponent = (shifted >> FRACTION_BITS) as i32 - BIAS as i32;
    let fraction = shifted & ((1 << FRACTION_BITS) - 1);
    let m = f64::from_bits(fraction + least);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    // 1 / (2 n + 1) from n = 8 down to 0; the next term is below 1e-14.
    let series = [17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0];
    let artanh = s * series.iter().fold(0.0, |sum, odd| sum * z + 1.0 / odd);
    f64::from(exponent) + 2.0 * LOG2_E * artanh
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Whether a float is the exact result or its neighbour.
    fn close(found: f32, exact: f64) -> bool {
        found.to_bits().abs_diff((exact as f32).to_bits()) <= 1
    }

    proptest! {
        #[test]
        fn results_are_those_of_doubles(x in -85.0f32..85.0, exponent in -20.0f32..20.0) {
            let positive = x.exp();
            prop_assert!(close(exp(x), f64::from(x).exp()));
            prop_assert!(close(ln(positive), f64::from(positive).ln()));
            prop_assert!(close(pow(positive, exponent), f64::from(positive).powf(exponent.into())));
        }
    }

    #[test]
    fn the_ends_are_those_of_floats() {
        let (smallest, infinity) = (f32::from_bits(1), f32::INFINITY);
        let found = [
            exp(-200.0),
            exp(200.0),
            exp(-infinity),
            ln(1.0),
            pow(1.0, 7.0),
            pow(3.0, 0.0),
            pow(2.0, -149.0),
        ];
        let exact = [0.0, infinity, 0.0, 0.0, 1.0, 1.0, smallest];
        assert_eq!(found.map(f32::to_bits), exact.map(f32::to_bits), "{found:?}");
        let undefined = [exp(f32::NAN), ln(-1.0), ln(f32::NAN), pow(-1.0, 2.0), pow(2.0, f32::NAN)];
        assert!(undefined.iter().all(|x| x.is_nan()), "{undefined:?}");
    }
}
