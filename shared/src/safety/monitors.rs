//! Which monitors are at work, and what all of them count with.

use super::alarms::Fault;
use crate::math;

/// Longest control period at which readings, one after the other, tell of the sensor itself, microseconds.
const QUICK_PERIOD_US: u32 = 5000;

/// The limit of a monitor that is left out: at 1 kHz no counter gets there in a month.
const NEVER: u32 = u32::MAX;

/// A set of monitors, named by what they find.
///
/// A ventilator has [`Monitors::ALL`]. A plant of another kind (no noise, another valve) can have those that ask nothing of
/// it, and a proof can leave one out to see that it is missed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Monitors(u32);

impl Monitors {
    /// All of them.
    pub const ALL: Self = Self(u32::MAX);
    /// Those that hold for any plant: is the reading a number, and is the pressure bearable?
    pub const ANY_PLANT: Self = Self(
        1 << Fault::ReadingNotANumber as u32
            | 1 << Fault::ReadingOutOfRange as u32
            | 1 << Fault::HighPressure as u32
            | 1 << Fault::HardLimit as u32,
    );

    /// The same without one.
    #[must_use]
    pub const fn without(self, fault: Fault) -> Self {
        Self(self.0 & !(1 << fault as u32))
    }

    /// Whether this one is at work.
    pub const fn has(self, fault: Fault) -> bool {
        self.0 & 1 << fault as u32 != 0
    }

    /// How often in a row a monitor has to see its fault: so often, or out of reach if it is left out.
    pub(super) fn limit(self, fault: Fault, limit: u32) -> u32 {
        if self.has(fault) { limit } else { NEVER }
    }

    /// The highest value that a monitor lets pass: this one, or any if it is left out.
    pub(super) fn highest(self, fault: Fault, highest: f32) -> f32 {
        if self.has(fault) { highest } else { f32::INFINITY }
    }
}

/// Whether readings come so quickly that their noise and their jumps tell of the sensor.
pub(super) const fn reads_quickly(period_us: u32) -> bool {
    period_us <= QUICK_PERIOD_US
}

/// A monitor's time in control ticks, at least one.
pub(super) fn ticks(seconds: f32, period_us: u32) -> u32 {
    math::ticks(seconds, period_us).max(1)
}

/// How often in a row something holds, counting this time.
pub(super) fn in_a_row(before: u32, holds: bool) -> u32 {
    if holds { before.saturating_add(1) } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_monitor_left_out_is_the_only_one_that_is_missing() {
        for left_out in Fault::all() {
            let monitors = Monitors::ALL.without(left_out);
            assert!(Fault::all().all(|fault| monitors.has(fault) == (fault != left_out)));
        }
    }

    #[test]
    fn times_are_never_shorter_than_a_tick() {
        assert_eq!((ticks(0.04, 1000), ticks(0.003, 50_000)), (40, 1));
        assert!(reads_quickly(1000) && !reads_quickly(50_000));
    }
}
