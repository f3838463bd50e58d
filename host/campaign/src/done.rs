//! Which places of a share are done.

use serde::{Deserialize, Serialize};

/// A set of numbers, as ranges of consecutive ones: a few, because work begins in order.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Done(Vec<(u64, u64)>);

impl Done {
    /// All numbers below `end`.
    pub fn below(end: u64) -> Self {
        Self((end > 0).then_some((0, end)).into_iter().collect())
    }

    /// Whether a number is in the set.
    pub fn contains(&self, number: u64) -> bool {
        let after = self.0.partition_point(|(first, _)| *first <= number);
        after > 0 && number < self.0[after - 1].1
    }

    /// Adds a number that is not yet in the set.
    pub fn insert(&mut self, number: u64) {
        let after = self.0.partition_point(|(first, _)| *first <= number);
        let extends = after > 0 && self.0[after - 1].1 == number;
        let precedes = self.0.get(after).is_some_and(|(first, _)| *first == number + 1);
        match (extends, precedes) {
            (true, true) => {
                self.0[after - 1].1 = self.0[after].1;
                self.0.remove(after);
            }
            (true, false) => self.0[after - 1].1 = number + 1,
            (false, true) => self.0[after].0 = number,
            (false, false) => self.0.insert(after, (number, number + 1)),
        }
    }

    /// How many numbers the set has.
    pub fn count(&self) -> u64 {
        self.0.iter().map(|(first, end)| end - first).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_any_order_become_ranges() {
        let mut done = Done::default();
        for (number, ranges) in [
            (4, vec![(4, 5)]),
            (0, vec![(0, 1), (4, 5)]),
            (1, vec![(0, 2), (4, 5)]),
            (3, vec![(0, 2), (3, 5)]),
        ] {
            done.insert(number);
            assert_eq!(done.0, ranges);
        }
        assert!(!done.contains(2) && [0, 1, 3, 4].iter().all(|number| done.contains(*number)));
        done.insert(2);
        assert_eq!(done, Done::below(5));
        assert!(!done.contains(5) && done.count() == 5);
        assert_eq!((Done::below(0).count(), Done::below(0)), (0, Done::default()));
    }
}
