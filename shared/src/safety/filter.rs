//! The valve command, which only the safety filter can make. Fulfils: valve-command.

use crate::control::COMMAND_MAX;
use crate::math;

/// Largest command of the self-test, percent.
pub(crate) const TEST_MAX: f32 = 20.0;

/// Command for the valves. Its fields are private and only the safety filter constructs it, so no controller can
/// bypass the filter.
///
/// Any code may pass a command on:
/// ```
/// let command = shared::safety::filter::ValveCommand::SAFE;
/// assert!(command.u_out());
/// ```
/// No code outside [`crate::safety`] can construct any other command,
/// ```compile_fail,E0451
/// let command = shared::safety::filter::ValveCommand { u_in: 80.0, u_out: false };
/// ```
/// change one,
/// ```compile_fail,E0616
/// let mut command = shared::safety::filter::ValveCommand::SAFE;
/// command.u_in = 80.0;
/// ```
/// or call the filter's own constructor:
/// ```compile_fail,E0624
/// let command = shared::safety::filter::ValveCommand::limited(80.0, false);
/// ```
/// The self-test of the device has a constructor of its own, with a far lower limit, which no other crate can call either:
/// ```compile_fail,E0624
/// let command = shared::safety::filter::ValveCommand::of_test(20.0, false, 5.0, 85.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValveCommand {
    u_in: f32,
    u_out: bool,
}

impl ValveCommand {
    /// The safe state: inspiratory valve closed, expiratory valve open, so that the pressure falls.
    pub const SAFE: Self = Self { u_in: 0.0, u_out: true };

    /// A command limited to the valve's range; NaN closes the inspiratory valve.
    pub(super) fn limited(u_in: f32, u_out: bool) -> Self {
        let u_in = math::limit(u_in, 0.0, COMMAND_MAX);
        debug_assert!((0.0..=COMMAND_MAX).contains(&u_in), "no command leaves the valve's range");
        Self { u_in, u_out }
    }

    /// A command of the self-test, in standby: limited to [`TEST_MAX`], and safe unless the reading is below a ceiling, cmH2O.
    pub(crate) fn of_test(u_in: f32, u_out: bool, reading: f32, ceiling: f32) -> Self {
        if reading < ceiling { Self { u_in: math::limit(u_in, 0.0, TEST_MAX), u_out } } else { Self::SAFE }
    }

    /// Inspiratory valve, percent of full opening.
    pub fn u_in(&self) -> f32 {
        self.u_in
    }

    /// Whether the expiratory valve is open.
    pub fn u_out(&self) -> bool {
        self.u_out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Verifies: valve-command.
        #[test]
        fn no_controller_output_leaves_the_valves_range(asked in prop::num::f32::ANY, u_out: bool) {
            let command = ValveCommand::limited(asked, u_out);
            prop_assert!((0.0..=100.0).contains(&command.u_in()));
            prop_assert_eq!(command.u_out(), u_out);
        }
    }

    proptest! {
        #[test]
        fn no_test_opens_the_valve_far_or_above_its_ceiling(
            asked in prop::num::f32::ANY, u_out: bool, reading in prop::num::f32::ANY, ceiling in 0.0f32..100.0,
        ) {
            let command = ValveCommand::of_test(asked, u_out, reading, ceiling);
            prop_assert!((0.0..=20.0).contains(&command.u_in()));
            if reading < ceiling {
                prop_assert_eq!(command.u_out(), u_out);
            } else {
                prop_assert_eq!(command, ValveCommand::SAFE);
            }
        }
    }

    #[test]
    fn a_nan_closes_the_inspiratory_valve() {
        assert!(ValveCommand::limited(f32::NAN, false).u_in().abs() < f32::EPSILON);
    }

    #[test]
    fn a_test_is_safe_at_its_ceiling_and_without_a_reading() {
        let test = |reading| ValveCommand::of_test(20.0, false, reading, 85.0);
        assert_eq!([test(85.0), test(f32::NAN)], [ValveCommand::SAFE; 2]);
        assert_eq!((test(84.9).u_in().to_bits(), test(84.9).u_out()), (20.0_f32.to_bits(), false));
    }
}
