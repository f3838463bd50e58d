//! Parameters of a rival: their names, units and bounds, and the values from which a search starts.

use shared::control::pid::{GAINS_MAX, GainError};
use thiserror::Error;

/// One number of a control law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Name for output.
    pub name: &'static str,
    /// Unit; empty for a pure number.
    pub unit: &'static str,
    /// What it does.
    pub meaning: &'static str,
    /// Values of the coarse grid, in ascending order.
    pub coarse: &'static [f32],
    /// Lowest and highest accepted value.
    pub bounds: (f32, f32),
    /// The value tuned for the family `adult`.
    pub tuned: f32,
}

impl Parameter {
    /// Whether a value is within the bounds; NaN never is.
    pub fn accepts(&self, value: f32) -> bool {
        let (least, most) = self.bounds;
        value >= least && value <= most
    }

    /// First step of a search that starts at this value: half the wider gap to its neighbours in the coarse grid.
    pub(super) fn step(&self, value: f32) -> f32 {
        let gaps = self.coarse.windows(2).filter(|pair| pair[0] <= value && value <= pair[1]);
        0.5 * gaps.map(|pair| pair[1] - pair[0]).fold(0.0, f32::max)
    }
}

const fn gain(name: &'static str, unit: &'static str, meaning: &'static str, most: f32) -> Parameter {
    Parameter { name, unit, meaning, coarse: &[], bounds: (0.0, most), tuned: 0.0 }
}

/// Proportional gain; each law sets its grid and its tuned value.
pub(super) const GAIN_P: Parameter = gain("p", "%/cmH2O", "proportional gain of the PID", GAINS_MAX.p);
/// Integral gain.
pub(super) const GAIN_I: Parameter = gain("i", "%/(cmH2O s)", "integral gain of the PID", GAINS_MAX.i);
/// Derivative gain.
pub(super) const GAIN_D: Parameter = gain("d", "% s/cmH2O", "derivative gain of the PID", GAINS_MAX.d);

/// Why a rival cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum RivalError {
    /// A gain of its PID is out of bounds.
    #[error(transparent)]
    Gain(#[from] GainError),
    /// Not one value for each parameter.
    #[error("{rival} has {wanted} parameters, not {given}")]
    Count {
        /// Name of the rival.
        rival: &'static str,
        /// Number of its parameters.
        wanted: usize,
        /// Number of values.
        given: usize,
    },
    /// The learned controller in it was trained for another control period.
    #[error("{learned} is trained for a control period of {trained_us} us, not {period_us}")]
    Period {
        /// Name of the learned controller.
        learned: &'static str,
        /// Its control period, microseconds.
        trained_us: u32,
        /// Requested control period, microseconds.
        period_us: u32,
    },
    /// A parameter is out of bounds.
    #[error("{name} is {value}, allowed are {least} to {most}")]
    OutOfBounds {
        /// Name of the parameter.
        name: &'static str,
        /// Requested value.
        value: f32,
        /// Lowest accepted value.
        least: f32,
        /// Highest accepted value.
        most: f32,
    },
}

/// Checks values against their parameters.
///
/// # Errors
/// The first value out of bounds.
pub(super) fn check(parameters: &[Parameter], values: &[f32]) -> Result<(), RivalError> {
    match parameters.iter().zip(values).find(|(parameter, value)| !parameter.accepts(**value)) {
        Some((Parameter { name, bounds: (least, most), .. }, value)) => {
            Err(RivalError::OutOfBounds { name, value: *value, least: *least, most: *most })
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_is_half_the_wider_gap_of_the_coarse_grid() {
        let parameter = Parameter { coarse: &[0.0, 1.0, 3.0, 10.0], ..GAIN_P };
        for (value, step) in [(0.0, 0.5), (1.0, 1.0), (3.0, 3.5), (5.0, 3.5)] {
            assert!((parameter.step(value) - step).abs() < 1e-6, "{value}");
        }
        assert!(
            Parameter { coarse: &[2.0], ..GAIN_P }.step(2.0).abs() < 1e-9,
            "a single value is not searched"
        );
    }

    #[test]
    fn nan_is_accepted_nowhere() {
        assert!(!GAIN_P.accepts(f32::NAN) && GAIN_P.accepts(0.0) && !GAIN_P.accepts(-0.1));
    }
}
