//! The only module that defines or names a mathematical function. Fulfils: same-bits.
//!
//! Everything here consists of additions, multiplications, divisions, comparisons and integer operations on the bits.
//! IEEE 754 defines their results exactly, so host and chip agree in every bit.

/// Limits `x` to `lo..=hi`; a NaN becomes `lo`, so that an invalid value can only *reduce* a command.
///
/// (`f32::clamp` returns NaN for NaN.)
#[inline]
pub fn limit(x: f32, lo: f32, hi: f32) -> f32 {
    if x >= lo { if x <= hi { x } else { hi } } else { lo }
}

/// Activation of the hidden layers, `x / (1 + |x|)`: smooth, bounded to ±1, and about 4 instructions where a
/// hyperbolic tangent takes about 100.
#[inline]
pub fn softsign(x: f32) -> f32 {
    x / (1.0 + x.abs())
}

/// Smoothing factor of a first-order lag: `step / (tau + step)`, both in seconds. A lag of zero or less gives 1, no
/// smoothing.
#[inline]
pub fn lag_factor(tau: f32, step: f32) -> f32 {
    if tau > 0.0 { step / (tau + step) } else { 1.0 }
}

/// Converts seconds to ticks of `tick_us` microseconds, rounded to the nearest.
#[inline]
pub fn ticks(seconds: f32, tick_us: u32) -> u32 {
    // In f64, since f32 cannot resolve 1 us in a minute.
    let exact = f64::from(seconds) * 1.0e6 / f64::from(tick_us.max(1));
    (exact + 0.5) as u32
}

/// Square root with a relative error below 1e-5; 0 for `x <= 0`, NaN for NaN.
///
/// Two Newton steps from micromath's estimate, which is up to 6 % off.
#[inline]
pub fn square_root(x: f32) -> f32 {
    if x <= 0.0 {
        return 0.0;
    }
    let guess = micromath::F32(x).sqrt().0;
    let better = 0.5 * (guess + x / guess);
    0.5 * (better + x / better)
}

/// Sine of an angle in turns, with an error below 1e-5.
///
/// A polynomial over the quarter turn next to zero, to which every angle is folded.
#[inline]
pub fn sine(turns: f32) -> f32 {
    let fraction = turns - turns as i32 as f32;
    // Now within -1 and 1: first to half a turn, then to a quarter.
    let half = if fraction > 0.5 {
        fraction - 1.0
    } else if fraction < -0.5 {
        fraction + 1.0
    } else {
        fraction
    };
    let quarter = if half > 0.25 {
        0.5 - half
    } else if half < -0.25 {
        -0.5 - half
    } else {
        half
    };
    let square = quarter * quarter;
    // The first terms of the power series of sin(2 pi x).
    let series = [core::f32::consts::TAU, -41.341_7, 81.605_25, -76.705_86, 42.058_693];
    quarter * series.iter().rev().fold(0.0, |sum, term| sum * square + term)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_sine_of_no_number_is_none() {
        assert!(sine(f32::NAN).is_nan());
    }

    #[test]
    fn a_nan_is_limited_to_the_lower_bound() {
        assert!((limit(f32::NAN, -3.0, 7.0) + 3.0).abs() < f32::EPSILON);
    }

    #[test]
    fn ticks_round_to_the_nearest() {
        assert_eq!(ticks(1.0, 1000), 1000);
        assert_eq!(ticks(1.0, 30_000), 33);
        assert_eq!(ticks(0.0014, 1000), 1);
        assert_eq!(ticks(-1.0, 1000), 0);
    }

    #[test]
    fn the_root_of_what_is_not_positive_is_zero() {
        assert_eq!([square_root(0.0), square_root(-4.0)].map(f32::to_bits), [0, 0]);
        assert!(square_root(f32::NAN).is_nan());
    }

    proptest! {
        #[test]
        fn a_root_squared_is_its_number(x in 1.0e-6f32..1.0e6) {
            let exact = f64::from(x).sqrt();
            prop_assert!((f64::from(square_root(x)) / exact - 1.0).abs() < 1.0e-5);
        }

        #[test]
        fn a_sine_is_that_of_the_angle(turns in -1.0e3f32..1.0e3) {
            let exact = (core::f64::consts::TAU * f64::from(turns)).sin();
            prop_assert!((f64::from(sine(turns)) - exact).abs() < 1.0e-5, "{}", turns);
        }

        #[test]
        fn limited_values_lie_within(x in prop::num::f32::ANY, lo in -50.0f32..0.0, width in 0.0f32..50.0) {
            let y = limit(x, lo, lo + width);
            prop_assert!(y >= lo && y <= lo + width);
        }

        #[test]
        fn softsign_is_odd_bounded_and_increasing(x in -1.0e6f32..1.0e6, step in 0.01f32..10.0) {
            prop_assert!(softsign(x).abs() <= 1.0);
            prop_assert_eq!(softsign(-x).to_bits(), (-softsign(x)).to_bits());
            prop_assert!(softsign(x + step) >= softsign(x));
        }
    }
}
