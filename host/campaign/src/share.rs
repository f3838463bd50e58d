//! The share of a run's units that one task does.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Largest number of shares.
const MOST: u64 = 1_000_000;

/// One of `of` shares of the units: those whose number leaves the remainder `index` when divided by `of`. This
/// spreads slow units, often the first ones, over all shares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Share {
    of: u64,
    index: u64,
}

impl Share {
    /// All units.
    pub const WHOLE: Self = Self { of: 1, index: 0 };

    /// Share `index` of `of`, counted from 0 or from 1: `of` is the same share as 0. None if `index` is larger, or without a share.
    pub fn new(index: u64, of: u64) -> Option<Self> {
        ((1..=MOST).contains(&of) && index <= of).then(|| Self { of, index: index % of })
    }

    /// All shares, when there are `of`.
    pub fn all(of: u64) -> impl Iterator<Item = Self> {
        (0..of).map(move |index| Self { of, index })
    }

    /// Number of shares.
    pub fn of(self) -> u64 {
        self.of
    }

    /// Its number, from 0.
    pub fn index(self) -> u64 {
        self.index
    }

    /// How many of `units` units are in the share.
    pub fn count(self, units: u64) -> u64 {
        (units + self.of - 1 - self.index) / self.of
    }

    /// The number of its unit at this place.
    pub fn unit(self, place: u64) -> u64 {
        self.index + place * self.of
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

impl FromStr for Share {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        parts.and_then(|(index, of)| Self::new(index, of)).ok_or_else(|| {
            format!(
                "'{text}' is not a shard: write i/n, such as 3/40, with i from 0 or 1 up and n from 1 to {MOST}"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shares_divide_the_units_without_loss_or_overlap() {
        for (units, of) in [(0, 3), (1, 7), (100, 1), (100, 7), (40, 40), (3, 40)] {
            let mut found: Vec<u64> = Share::all(of)
                .flat_map(|share| (0..share.count(units)).map(move |place| share.unit(place)))
                .collect();
            found.sort_unstable();
            assert_eq!(found, (0..units).collect::<Vec<_>>(), "{units} in {of}");
        }
    }

    #[test]
    fn shares_are_counted_from_0_or_from_1() {
        assert_eq!("40/40".parse(), "0/40".parse::<Share>());
        assert_eq!("3/40".parse::<Share>().unwrap().to_string(), "3/40");
        for wrong in ["", "3", "41/40", "1/0", "-1/2", "a/b", "1/2/3", "1/1000001"] {
            assert!(wrong.parse::<Share>().is_err(), "{wrong}");
        }
    }
}
