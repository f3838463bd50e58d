//! Which monitors are at work, and their times in control ticks.

use super::alarms::Fault;
use crate::math;

/// Longest control period at which readings, one after the other, tell of the sensor itself, microseconds.
const QUICK_PERIOD_US: u32 = 5000;

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
}

/// Times of the monitors in control ticks, so that no tick has to convert them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// Whether readings come so quickly that their noise and their jumps tell of the sensor.
    pub quick: bool,
    /// Readings may be missing for so long.
    pub missing: u32,
    /// A reading may stay the same to the last bit for so long.
    pub frozen: u32,
    /// The pressure may exceed its limit for so long, a spike of noise.
    pub spike: u32,
    /// It may do so with the expiratory valve open for so long.
    pub venting: u32,
    /// It may stay away from PEEP for so long.
    pub sustained: u32,
    /// The end of a phase, over which a pressure is averaged.
    pub end_of_phase: u32,
    /// The airway pressure may be gone for so long.
    pub disconnected: u32,
    /// It may leave the valve's delivery unanswered for so long.
    pub unanswered: u32,
    /// It may stand still against it for so long.
    pub stands: u32,
}

impl Times {
    /// The times at a control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        let at_least_one = |seconds| math::ticks(seconds, period_us).max(1);
        Self {
            quick: period_us <= QUICK_PERIOD_US,
            missing: at_least_one(0.005),
            frozen: at_least_one(0.04),
            spike: at_least_one(0.003),
            venting: at_least_one(0.15),
            sustained: at_least_one(15.0),
            end_of_phase: at_least_one(0.05),
            disconnected: at_least_one(0.15),
            unanswered: at_least_one(0.04),
            stands: at_least_one(0.02),
        }
    }
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
        assert_eq!(Times::new(1000).frozen, 40);
        let slow = Times::new(50_000);
        assert_eq!((slow.missing, slow.spike, slow.quick), (1, 1, false));
    }
}
