//! Parameters of each member of a family (test runs, ventilators). An unknown member has zeros.

use super::super::Members;
use engine::{LANES, Lane};

/// The family's parameters, member by member.
#[derive(Clone, Debug)]
pub(super) struct Own {
    width: usize,
    values: Vec<f32>,
}

impl Own {
    /// A family whose members have `width` parameters each.
    pub fn new(width: usize, values: &[f32]) -> Self {
        Self { width, values: values.to_vec() }
    }

    /// Index of the `n`-th parameter of a member; `None` if it is unknown or outside the family.
    fn index(&self, member: Option<u32>, n: usize) -> Option<usize> {
        let index = member? as usize * self.width + n;
        (index < self.values.len()).then_some(index)
    }

    /// The `n`-th parameter of the member in each lane.
    pub fn lane(&self, members: &Members, n: usize) -> Lane {
        Lane::from_fn(|l| self.index(members[l], n).map_or(0.0, |index| self.values[index]))
    }

    /// Adds the gradient with respect to the members' `n`-th parameters to the family's gradient.
    pub fn add_gradient(&self, members: &Members, n: usize, d: &Lane, gradient: &mut [f32]) {
        for l in 0..LANES {
            if let Some(index) = self.index(members[l], n) {
                gradient[index] += d[l];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_have_what_is_theirs_and_strangers_nothing() {
        let own = Own::new(2, &[1.0, 2.0, 3.0, 4.0]);
        let members = std::array::from_fn(|l| (l as u32).checked_sub(1));
        let lane = own.lane(&members, 1);
        assert_eq!(
            [lane[0], lane[1], lane[2], lane[3]].map(f32::to_bits),
            [0.0, 2.0, 4.0, 0.0].map(f32::to_bits)
        );
        let mut gradient = [0.0; 4];
        own.add_gradient(&members, 1, &Lane::splat(5.0), &mut gradient);
        assert_eq!(gradient.map(f32::to_bits), [0.0, 5.0, 0.0, 5.0].map(f32::to_bits));
    }
}
