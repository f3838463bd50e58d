//! The set of enabled monitors and responses, and helpers that all monitors use.

use super::alarms::Fault;
use super::responses::{Response, Responses};
use crate::math;

/// Longest control period at which consecutive readings allow a check of the sensor's noise and jumps, microseconds.
const QUICK_PERIOD_US: u32 = 5000;

/// Limit of a disabled monitor: at 1 kHz a counter takes 49 days to reach it.
const NEVER: u32 = u32::MAX;

/// A set of monitors, named by the fault that they detect, and of responses.
///
/// A ventilator uses [`Monitors::ALL`]. A plant of another kind (no noise, another valve) uses the monitors that suit it,
/// and a test can leave out a monitor or a response to show that it is needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Monitors {
    monitors: u32,
    responses: Responses,
}

impl Monitors {
    /// All monitors and responses.
    pub const ALL: Self = Self { monitors: u32::MAX, responses: Responses::ALL };
    /// The monitors that suit any plant: they check that the reading is a number in range and the pressure within its limits.
    pub const ANY_PLANT: Self = Self {
        monitors: 1 << Fault::ReadingNotANumber as u32
            | 1 << Fault::ReadingOutOfRange as u32
            | 1 << Fault::HighPressure as u32
            | 1 << Fault::HardLimit as u32,
        responses: Responses::ALL,
    };

    /// The same set without one monitor.
    #[must_use]
    pub const fn without(self, fault: Fault) -> Self {
        Self { monitors: self.monitors & !(1 << fault as u32), ..self }
    }

    /// The same set without one response.
    #[must_use]
    pub const fn without_response(self, response: Response) -> Self {
        Self { responses: self.responses.without(response), ..self }
    }

    /// The enabled responses.
    pub const fn responses(self) -> Responses {
        self.responses
    }

    /// Whether a monitor is enabled.
    pub const fn has(self, fault: Fault) -> bool {
        self.monitors & 1 << fault as u32 != 0
    }

    /// The limit of a monitor's counter: `limit`, or [`NEVER`] if the monitor is disabled.
    pub(super) fn limit(self, fault: Fault, limit: u32) -> u32 {
        if self.has(fault) { limit } else { NEVER }
    }

    /// The highest value that a monitor accepts: `highest`, or infinity if the monitor is disabled.
    pub(super) fn highest(self, fault: Fault, highest: f32) -> f32 {
        if self.has(fault) { highest } else { f32::INFINITY }
    }
}

/// Whether the control period is short enough to check the sensor's noise and jumps.
pub(super) const fn reads_quickly(period_us: u32) -> bool {
    period_us <= QUICK_PERIOD_US
}

/// Converts a monitor's time to control ticks, at least one.
pub(crate) fn ticks(seconds: f32, period_us: u32) -> u32 {
    math::ticks(seconds, period_us).max(1)
}

/// Counts consecutive ticks or breaths in which a condition is true, including this one.
pub(crate) fn in_a_row(before: u32, holds: bool) -> u32 {
    if holds { before.saturating_add(1) } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn a_monitor_left_out_is_the_only_one_that_is_missing() {
        for left_out in Fault::all() {
            let monitors = Monitors::ALL.without(left_out);
            assert!(Fault::all().all(|fault| monitors.has(fault) == (fault != left_out)));
        }
    }

    #[test]
    fn a_response_left_out_leaves_every_monitor() {
        let without = Monitors::ALL.without_response(Response::Backup);
        assert_eq!(without.responses(), Responses::ALL.without(Response::Backup));
        assert!(Fault::all().all(|fault| without.has(fault)));
        assert_eq!(Monitors::ALL.without(Fault::Leak).responses(), Responses::ALL);
    }

    #[test]
    fn any_plant_has_a_reading_and_a_bearable_pressure() {
        let monitors: Vec<_> = Fault::all().filter(|fault| Monitors::ANY_PLANT.has(*fault)).collect();
        let expected =
            [Fault::ReadingNotANumber, Fault::ReadingOutOfRange, Fault::HighPressure, Fault::HardLimit];
        assert_eq!(monitors, expected);
    }

    #[test]
    fn times_are_never_shorter_than_a_tick() {
        assert_eq!((ticks(0.04, 1000), ticks(0.003, 50_000)), (40, 1));
        assert!(reads_quickly(1000) && !reads_quickly(50_000));
    }
}
