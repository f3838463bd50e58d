//! Complex numbers, as far as frequency responses need them.

use std::f64::consts::PI;
use std::ops::{Add, Div, Mul, Neg, Sub};

use serde::{Deserialize, Serialize};

/// A complex number; in JSON a list of real and imaginary part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "(f64, f64)", into = "(f64, f64)")]
pub struct Complex {
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
}

impl Complex {
    /// One.
    pub const ONE: Self = Self { re: 1.0, im: 0.0 };

    /// The number of magnitude one with this angle in radians.
    pub fn turn(angle: f64) -> Self {
        Self { re: angle.cos(), im: angle.sin() }
    }

    /// Magnitude.
    pub fn abs(self) -> f64 {
        self.re.hypot(self.im)
    }

    /// Angle in radians, from -pi to pi.
    pub fn angle(self) -> f64 {
        self.im.atan2(self.re)
    }

    /// The number multiplied by a real factor.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self { re: factor * self.re, im: factor * self.im }
    }
}

/// The angle in radians that differs from this one by whole turns and lies within half a turn of `near`.
pub fn unwrapped(angle: f64, near: f64) -> f64 {
    angle + 2.0 * PI * ((near - angle) / (2.0 * PI)).round()
}

impl From<(f64, f64)> for Complex {
    fn from((re, im): (f64, f64)) -> Self {
        Self { re, im }
    }
}

impl From<Complex> for (f64, f64) {
    fn from(number: Complex) -> Self {
        (number.re, number.im)
    }
}

impl From<f64> for Complex {
    fn from(re: f64) -> Self {
        Self { re, im: 0.0 }
    }
}

impl Add for Complex {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }
}

impl Sub for Complex {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }
}

impl Neg for Complex {
    type Output = Self;
    fn neg(self) -> Self {
        self.times(-1.0)
    }
}

impl Mul for Complex {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { re: self.re * other.re - self.im * other.im, im: self.re * other.im + self.im * other.re }
    }
}

impl Div for Complex {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let size = other.re * other.re + other.im * other.im;
        let conjugate = Self { re: other.re, im: -other.im };
        (self * conjugate).times(1.0 / size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_add_angles_and_multiply_magnitudes() {
        let (one, other) = (Complex::turn(0.4).times(2.0), Complex::turn(0.5).times(3.0));
        let product = one * other;
        assert!((product.abs() - 6.0).abs() < 1e-12 && (product.angle() - 0.9).abs() < 1e-12);
        let back = product / other - one;
        assert!(back.abs() < 1e-12);
        assert!((one + -one).abs() < 1e-12);
    }

    #[test]
    fn an_angle_is_unwrapped_to_its_neighbour() {
        for (angle, near, expected) in
            [(3.0, -3.0, 3.0 - 2.0 * PI), (0.5, 0.4, 0.5), (-3.0, 9.0, 4.0 * PI - 3.0)]
        {
            assert!((unwrapped(angle, near) - expected).abs() < 1e-12, "{angle} {near}");
        }
    }

    #[test]
    fn json_is_a_pair() {
        let number = Complex { re: 1.5, im: -2.0 };
        let text = serde_json::to_string(&number).unwrap();
        assert_eq!(text, "[1.5,-2.0]");
        assert_eq!(serde_json::from_str::<Complex>(&text).unwrap(), number);
    }
}
