//! The supervisor: is the reading believable, is the pressure bearable?
//!
//! A reading that is no number or out of the sensor's range is replaced by the last good one for a few ticks
//! and then latches a fault; a pressure above the limit that stays there latches a fault. A latched fault ends
//! only by [`Supervisor::clear`], asked for by an operator.

use serde::{Deserialize, Serialize};

use super::filter::ValveCommand;
use crate::breath::Breath;
use crate::math;

/// Readings outside of this range are not from a working sensor, cmH2O.
pub const SENSOR_RANGE: (f32, f32) = (-30.0, 110.0);
/// How long readings may be missing before the fault latches, s.
pub const MISSING_TIME: f32 = 0.005;
/// How long the pressure may exceed its limit before the fault latches, s: longer than a spike of noise, far
/// shorter than the 0.2 s in which a ventilator must vent.
pub const HIGH_PRESSURE_TIME: f32 = 0.01;

/// Why the ventilator stands in its safe state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// The pressure reading is no number.
    ReadingNotANumber,
    /// The pressure reading is outside of [`SENSOR_RANGE`].
    ReadingOutOfRange,
    /// The airway pressure exceeded its limit.
    HighPressure,
}

/// Counters and latch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supervisor {
    fault: Option<Fault>,
    missing: u32,
    high: u32,
    last_good: Option<f32>,
}

impl Supervisor {
    /// Nothing has happened yet.
    pub const fn new() -> Self {
        Self { fault: None, missing: 0, high: 0, last_good: None }
    }

    /// The latched fault.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Takes in one reading; the pressure to control with, or none while there is nothing to believe.
    pub fn check(&mut self, reading: f32, breath: &Breath) -> Option<f32> {
        let problem = if reading.is_nan() {
            Some(Fault::ReadingNotANumber)
        } else if !(reading >= SENSOR_RANGE.0 && reading <= SENSOR_RANGE.1) {
            Some(Fault::ReadingOutOfRange)
        } else {
            None
        };
        if let Some(fault) = problem {
            self.missing += 1;
            self.latch_after(self.missing, MISSING_TIME, breath, fault);
        } else {
            self.missing = 0;
            self.last_good = Some(reading);
            self.check_high(reading, breath);
        }
        if self.fault.is_some() { None } else { self.last_good }
    }

    fn check_high(&mut self, pressure: f32, breath: &Breath) {
        if pressure <= breath.settings().pressure_limit {
            self.high = 0;
        } else {
            self.high += 1;
            self.latch_after(self.high, HIGH_PRESSURE_TIME, breath, Fault::HighPressure);
        }
    }

    fn latch_after(&mut self, count: u32, time: f32, breath: &Breath, fault: Fault) {
        if count >= math::ticks(time, breath.period_us()).max(1) {
            self.fault.get_or_insert(fault);
        }
    }

    /// The safety filter: the wish, or the safe command while a fault is latched.
    pub fn command(&self, u_in: f32, u_out: bool) -> ValveCommand {
        if self.fault.is_some() { ValveCommand::SAFE } else { ValveCommand::limited(u_in, u_out) }
    }

    /// Forgets the fault, by an operator's wish.
    pub fn clear(&mut self) {
        *self = Self::new();
    }
}

impl Default for Supervisor {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};

    fn breath() -> Breath {
        Breath::new(&paper_settings(20.0), DEFAULT_PERIOD_US).unwrap()
    }

    fn feed(readings: &[f32]) -> Supervisor {
        let mut supervisor = Supervisor::new();
        for reading in readings {
            supervisor.check(*reading, &breath());
        }
        supervisor
    }

    #[test]
    fn a_single_missing_reading_is_bridged_by_the_last_good_one() {
        let mut supervisor = feed(&[12.0]);
        assert_eq!(supervisor.check(f32::NAN, &breath()), Some(12.0));
        assert_eq!(supervisor.fault(), None);
    }

    #[test]
    fn missing_readings_latch() {
        assert_eq!(feed(&[f32::NAN; 4]).fault(), None);
        assert_eq!(feed(&[f32::NAN; 5]).fault(), Some(Fault::ReadingNotANumber));
        assert_eq!(feed(&[f32::INFINITY; 5]).fault(), Some(Fault::ReadingOutOfRange));
        assert_eq!(feed(&[-31.0; 5]).fault(), Some(Fault::ReadingOutOfRange));
    }

    #[test]
    fn a_good_reading_ends_the_count_of_missing_ones() {
        let mut readings = [f32::NAN; 9];
        readings[4] = 10.0;
        assert_eq!(feed(&readings).fault(), None);
    }

    #[test]
    fn high_pressure_latches_within_ten_milliseconds() {
        assert_eq!(feed(&[60.5; 9]).fault(), None);
        assert_eq!(feed(&[60.5; 10]).fault(), Some(Fault::HighPressure));
        assert_eq!(feed(&[59.5; 100]).fault(), None);
    }

    #[test]
    fn a_latched_fault_stays_and_commands_the_safe_state() {
        let mut supervisor = feed(&[60.5; 10]);
        for _ in 0..1000 {
            assert_eq!(supervisor.check(5.0, &breath()), None);
        }
        assert_eq!(supervisor.command(80.0, false), ValveCommand::SAFE);
        supervisor.clear();
        assert!((supervisor.command(80.0, false).u_in() - 80.0).abs() < f32::EPSILON);
    }
}
