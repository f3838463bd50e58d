//! Characteristic of the inspiratory valve: its flow over the travel of its stem, a dead zone and then a power law.
//!
//! The power law is interpolated between points. A computer keeps all of them in a table; a chip, which has no memory for it, keeps the
//! two beside the stem. The points are the same.

use core::f64::consts::LN_2;

use crate::math::exp2;

/// Intervals between the points: the error of `x^1.3` between them is below 1e-5.
const INTERVALS: u32 = 1024;
/// Points, with an extra one, so that interpolation at full travel has a right neighbour.
const POINTS: usize = INTERVALS as usize + 2;

/// Flow through the stem over its travel, as a share of the full flow.
#[derive(Clone, Debug)]
pub(super) struct Characteristic {
    dead_zone: f64,
    /// Intervals per percent of travel beyond the dead zone.
    scale: f64,
    points: Points,
}

impl Characteristic {
    /// That of a valve with this dead zone, percent of the travel, and this exponent beyond it.
    pub(super) fn new(dead_zone_percent: f64, exponent: f64) -> Self {
        let scale = f64::from(INTERVALS) / (100.0 - dead_zone_percent);
        Self { dead_zone: dead_zone_percent, scale, points: Points::new(exponent) }
    }

    /// The share with the stem at this percentage of its travel.
    pub(super) fn share(&mut self, stem_percent: f64) -> f64 {
        let place = ((stem_percent - self.dead_zone) * self.scale).clamp(0.0, f64::from(INTERVALS));
        let index = place as u32;
        let (left, right) = self.points.beside(index);
        left + (right - left) * (place - f64::from(index))
    }
}

/// The power law at the point with this number, from 0. A general power would take a chip ten times as long.
fn point(index: u32, exponent: f64) -> f64 {
    exp2(exponent * LOGARITHMS[index as usize])
}

/// Binary logarithm of the travel at each point, as a share of the whole; computed by the compiler.
static LOGARITHMS: [f64; POINTS] = logarithms();

const fn logarithms() -> [f64; POINTS] {
    let mut logarithms = [f64::NEG_INFINITY; POINTS];
    let mut index = 1;
    while index < POINTS {
        logarithms[index] = log2(index as f64 / INTERVALS as f64);
        index += 1;
    }
    logarithms
}

/// Binary logarithm of a number above zero, by the series of the area tangent.
const fn log2(x: f64) -> f64 {
    let (mut mantissa, mut whole) = (x, 0.0);
    while mantissa < 1.0 {
        mantissa *= 2.0;
        whole -= 1.0;
    }
    let z = (mantissa - 1.0) / (mantissa + 1.0);
    let (mut power, mut sum, mut n) = (z, 0.0, 1.0);
    while n < 40.0 {
        sum += power / n;
        power *= z * z;
        n += 2.0;
    }
    whole + 2.0 * sum / LN_2
}

#[cfg(feature = "std")]
use tabulated::Points;

/// All points, in a table.
#[cfg(feature = "std")]
mod tabulated {
    use std::sync::{Arc, LazyLock};

    use super::{POINTS, point};
    use crate::config::ValveConfig;

    /// The points of the default exponent. Benches share them, so that many benches fit the processor's cache together.
    static DEFAULT: LazyLock<Arc<[f64]>> = LazyLock::new(|| table(ValveConfig::default().curve_exponent));

    #[derive(Clone, Debug)]
    pub(super) struct Points(Arc<[f64]>);

    fn table(exponent: f64) -> Arc<[f64]> {
        (0..POINTS as u32).map(|index| point(index, exponent)).collect()
    }

    impl Points {
        pub(super) fn new(exponent: f64) -> Self {
            let is_default = exponent.to_bits() == ValveConfig::default().curve_exponent.to_bits();
            Self(if is_default { DEFAULT.clone() } else { table(exponent) })
        }

        /// The points to the left and right of an interval.
        pub(super) fn beside(&self, index: u32) -> (f64, f64) {
            (self.0[index as usize], self.0[index as usize + 1])
        }
    }
}

#[cfg(any(test, not(feature = "std")))]
mod kept {
    use super::point;

    /// The two points beside the last place.
    #[derive(Clone, Debug)]
    pub(super) struct Points {
        exponent: f64,
        index: u32,
        beside: (f64, f64),
    }

    impl Points {
        pub(super) fn new(exponent: f64) -> Self {
            Self { exponent, index: 0, beside: (point(0, exponent), point(1, exponent)) }
        }

        /// The points to the left and right of an interval.
        pub(super) fn beside(&mut self, index: u32) -> (f64, f64) {
            if index != self.index {
                let (left, right) = self.beside;
                let at = |index| point(index, self.exponent);
                self.beside = if index == self.index + 1 {
                    (right, at(index + 1))
                } else if index + 1 == self.index {
                    (at(index), left)
                } else {
                    (at(index), at(index + 1))
                };
                self.index = index;
            }
            self.beside
        }
    }
}

#[cfg(not(feature = "std"))]
use kept::Points;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_point_is_the_power_of_its_place(index in 0..POINTS as u32, exponent in 0.5..4.0) {
            let expected = (f64::from(index) / f64::from(INTERVALS)).powf(exponent);
            prop_assert!((point(index, exponent) - expected).abs() <= 1e-14 * expected);
        }

        #[test]
        fn the_points_that_a_chip_keeps_are_those_of_the_table(
            exponent in 0.5..4.0, places in prop::collection::vec(0..=INTERVALS, 1..40), steps in 0..3_u32,
        ) {
            let table = Points::new(exponent);
            let mut kept = kept::Points::new(exponent);
            for place in places {
                for index in [place, (place + steps).min(INTERVALS), place.saturating_sub(steps)] {
                    let (expected, found) = (table.beside(index), kept.beside(index));
                    prop_assert_eq!(expected.0.to_bits(), found.0.to_bits());
                    prop_assert_eq!(expected.1.to_bits(), found.1.to_bits());
                }
            }
        }
    }
}
