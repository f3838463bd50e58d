//! Bounds of the shapes of simulators, for files that are damaged or come from elsewhere.

use thiserror::Error;

/// Largest number of states, hidden units or past blocks of a network.
const WIDTH_MAX: usize = 10_000;
/// Largest number of units, ventilators or test runs of a simulator.
const MEMBERS_MAX: usize = 1_000_000;

/// A number in the description of a simulator is out of bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{name} is {value}, but must be from {least} to {most}: fit the simulator again")]
pub struct ShapeError {
    /// Name of the number.
    pub name: &'static str,
    /// Its value.
    pub value: usize,
    /// Least value.
    pub least: usize,
    /// Largest value.
    pub most: usize,
}

/// Checks a number.
pub(super) fn within(name: &'static str, value: usize, least: usize, most: usize) -> Result<(), ShapeError> {
    if (least..=most).contains(&value) { Ok(()) } else { Err(ShapeError { name, value, least, most }) }
}

/// Checks the widths of a network.
pub(super) fn widths(states: usize, hidden: usize, history: usize) -> Result<(), ShapeError> {
    let widths = [("states", states), ("hidden", hidden), ("history", history)];
    widths.into_iter().try_for_each(|(name, value)| within(name, value, 1, WIDTH_MAX))
}

/// Checks a number of units, ventilators or test runs.
pub(super) fn members(name: &'static str, value: usize, least: usize) -> Result<(), ShapeError> {
    within(name, value, least, MEMBERS_MAX)
}
