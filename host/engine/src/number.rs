//! The numbers of an equation.
//!
//! An equation that is generic over [`Number`] is written once and read in three ways: on a [`Lane`] it
//! computes; of [`Recorded`](crate::tape::Recorded) numbers a tape computes the gradient; and as symbols it
//! becomes a part of an ONNX graph.
#![expect(
    clippy::inline_always,
    reason = "an equation is compiled to vector operations only where all of its operations are inlined"
)]

use std::ops::{Add, Div, Mul, Sub};

use crate::lane::{LANES, Lane};
use crate::power;

/// An operation on one number, by its name in ONNX.
#[derive(Clone, Copy, Debug)]
pub enum Unary {
    /// Square root.
    Sqrt,
    /// Absolute value.
    Abs,
    /// Power of e.
    Exp,
    /// Largest whole number that is not above.
    Floor,
}

/// An operation on two numbers, by its name in ONNX.
#[derive(Clone, Copy, Debug)]
pub enum Binary {
    /// Sum.
    Add,
    /// Difference.
    Sub,
    /// Product.
    Mul,
    /// Quotient.
    Div,
    /// The smaller one.
    Min,
    /// The larger one.
    Max,
    /// The first one to the power of the second.
    Pow,
}

/// A number in an equation, or one number for each rollout of a shard.
pub trait Number:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// A constant beside this number.
    #[must_use]
    fn constant(self, value: f32) -> Self;

    /// The result of an operation on this number.
    #[must_use]
    fn one(self, operation: Unary) -> Self;

    /// The result of an operation on this and another number.
    #[must_use]
    fn two(self, operation: Binary, other: Self) -> Self;

    /// This number where `left > right`, otherwise zero.
    #[must_use]
    fn where_greater(self, left: Self, right: Self) -> Self;

    /// Square root.
    #[must_use]
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.one(Unary::Sqrt)
    }

    /// Absolute value.
    #[must_use]
    #[inline(always)]
    fn abs(self) -> Self {
        self.one(Unary::Abs)
    }

    /// `e^self`.
    #[must_use]
    #[inline(always)]
    fn exp(self) -> Self {
        self.one(Unary::Exp)
    }

    /// Largest whole number that is not above; a constant for the gradient.
    #[must_use]
    #[inline(always)]
    fn floor(self) -> Self {
        self.one(Unary::Floor)
    }

    /// The smaller number; if they are equal, the gradient is that of `other`.
    #[must_use]
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.two(Binary::Min, other)
    }

    /// The larger number; if they are equal, the gradient is that of `other`.
    #[must_use]
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.two(Binary::Max, other)
    }

    /// `self^exponent` of a positive number.
    #[must_use]
    #[inline(always)]
    fn pow(self, exponent: Self) -> Self {
        self.two(Binary::Pow, exponent)
    }
}

/// Implements the operators of a [`Number`].
#[macro_export]
macro_rules! operators {
    ($number:ty) => {
        $crate::operators!($number, Add add, Sub sub, Mul mul, Div div);
    };
    ($number:ty, $($operator:ident $method:ident),+) => {$(
        impl std::ops::$operator for $number {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                $crate::number::Number::two(self, $crate::number::Binary::$operator, other)
            }
        }
    )+};
}

operators!(Lane);

impl Number for Lane {
    #[inline(always)]
    fn constant(self, value: f32) -> Self {
        Self::splat(value)
    }

    #[inline(always)]
    fn one(self, operation: Unary) -> Self {
        match operation {
            Unary::Sqrt => self.map(f32::sqrt),
            Unary::Abs => self.map(f32::abs),
            Unary::Exp => each(|l| power::exp(self[l])),
            Unary::Floor => self.map(f32::floor),
        }
    }

    #[inline(always)]
    fn two(self, operation: Binary, other: Self) -> Self {
        match operation {
            Binary::Add => self.zip(&other, |a, b| a + b),
            Binary::Sub => self.zip(&other, |a, b| a - b),
            Binary::Mul => self.zip(&other, |a, b| a * b),
            Binary::Div => self.zip(&other, |a, b| a / b),
            Binary::Min => self.zip(&other, |a, b| if a < b { a } else { b }),
            Binary::Max => self.zip(&other, |a, b| if a > b { a } else { b }),
            Binary::Pow => each(|l| power::pow(self[l], other[l])),
        }
    }

    #[inline(always)]
    fn where_greater(self, left: Self, right: Self) -> Self {
        each(|l| if left[l] > right[l] { self[l] } else { 0.0 })
    }
}

/// A lane of the value `f(l)` for rollout `l`, as a loop: of a long function, the compiler makes no vectors otherwise.
#[inline(always)]
pub(crate) fn each(f: impl Fn(usize) -> f32) -> Lane {
    let mut values = Lane::ZERO;
    for l in 0..LANES {
        values[l] = f(l);
    }
    values
}
