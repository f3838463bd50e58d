//! Can the pressure reading be believed?
//!
//! A reading that cannot is replaced by the last good one, for a few milliseconds. A sound sensor is never quite still and
//! never jumps: its noise proves that it lives.

use super::alarms::Fault;
use super::monitors::{Monitors, Times};

/// Readings outside of this range are not from a working sensor, cmH2O.
pub const SENSOR_RANGE: (f32, f32) = (-30.0, 110.0);
/// Highest change from one reading to the next that a pressure behind the sensor's lag can make, cmH2O.
pub const JUMP_MAX: f32 = 15.0;
/// Highest standard deviation of a sound sensor's noise, cmH2O.
pub const NOISE_MAX: f32 = 0.4;
/// Mean of the absolute second difference of white noise per standard deviation: `sqrt(6) sqrt(2 / pi)`.
const SECOND_DIFFERENCE: f32 = 1.954;
/// Share of a new second difference in their mean.
const NOISE_SHARE: f32 = 0.02;
/// Good readings that make up for a missing one.
const MAKE_UP: u32 = 9;

/// What the readings so far say of the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    last_good: Option<f32>,
    before: f32,
    /// Missing readings, each counted [`MAKE_UP`] times, less the good ones since.
    debt: u32,
    /// How often each problem has come since there was none: no number, out of range, jumps.
    problems: [u32; 3],
    /// Consecutive ticks without a good reading.
    gap: u32,
    same: u32,
    second_difference: f32,
}

/// What became of a reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Believed {
    /// The pressure to go on with, cmH2O; none while there was never a good reading.
    pub pressure: Option<f32>,
    /// Whether it is the reading itself and not what replaces it.
    pub fresh: bool,
    /// What is wrong with the sensor.
    pub fault: Option<Fault>,
}

impl Reading {
    /// Nothing has been read yet.
    pub const fn new() -> Self {
        Self {
            last_good: None,
            before: 0.0,
            debt: 0,
            problems: [0; 3],
            gap: 0,
            same: 0,
            second_difference: 0.0,
        }
    }

    /// Takes in one reading; `moving` says that a breath runs, so that a sound sensor cannot stand still.
    #[inline]
    pub fn check(&mut self, reading: f32, moving: bool, monitors: Monitors, times: &Times) -> Believed {
        if let Some(problem) = self.problem(reading, monitors, times) {
            return self.bridge(problem, times);
        }
        self.debt = self.debt.saturating_sub(1);
        if self.debt == 0 {
            self.problems = [0; 3];
        }
        let fault = self.good(reading, moving, monitors, times);
        Believed { pressure: Some(reading), fresh: true, fault }
    }

    /// Why a reading counts as missing.
    fn problem(&self, reading: f32, monitors: Monitors, times: &Times) -> Option<Fault> {
        if reading.is_nan() {
            return Some(Fault::ReadingNotANumber);
        }
        let in_range = reading >= SENSOR_RANGE.0 && reading <= SENSOR_RANGE.1;
        if !in_range && monitors.has(Fault::ReadingOutOfRange) {
            return Some(Fault::ReadingOutOfRange);
        }
        let jump = self.last_good.map_or(0.0, |last| (reading - last).abs());
        // The longer the gap, the further the pressure may have come.
        let possible = JUMP_MAX * (self.gap + 1) as f32;
        (times.quick && monitors.has(Fault::ReadingJumps) && jump > possible).then_some(Fault::ReadingJumps)
    }

    fn bridge(&mut self, problem: Fault, times: &Times) -> Believed {
        self.gap = self.gap.saturating_add(1);
        self.debt = self.debt.saturating_add(MAKE_UP);
        let [no_number, out_of_range, jumps] = &mut self.problems;
        let count = match problem {
            Fault::ReadingNotANumber => no_number,
            Fault::ReadingOutOfRange => out_of_range,
            _ => jumps,
        };
        *count = count.saturating_add(1);
        let fault = (self.debt >= times.missing * MAKE_UP).then(|| self.main_problem());
        Believed { pressure: self.last_good, fresh: false, fault }
    }

    /// The problem that came most often.
    fn main_problem(&self) -> Fault {
        let [no_number, out_of_range, jumps] = self.problems;
        if jumps >= no_number.max(out_of_range) {
            Fault::ReadingJumps
        } else if out_of_range >= no_number {
            Fault::ReadingOutOfRange
        } else {
            Fault::ReadingNotANumber
        }
    }

    fn good(&mut self, reading: f32, moving: bool, monitors: Monitors, times: &Times) -> Option<Fault> {
        let (last, before) = (self.last_good.replace(reading), self.before);
        self.before = last.unwrap_or(reading);
        let (Some(last), 0, true, true) = (last, self.gap, moving, times.quick) else {
            (self.gap, self.same, self.before) = (0, 0, reading);
            return None;
        };
        self.same = if reading.to_bits() == last.to_bits() { self.same + 1 } else { 0 };
        let second_difference = (reading - 2.0 * last + before).abs();
        self.second_difference += NOISE_SHARE * (second_difference - self.second_difference);
        if monitors.has(Fault::ReadingFrozen) && self.same >= times.frozen {
            return Some(Fault::ReadingFrozen);
        }
        let noisy = self.second_difference > NOISE_MAX * SECOND_DIFFERENCE;
        (monitors.has(Fault::ReadingNoisy) && noisy).then_some(Fault::ReadingNoisy)
    }
}

impl Default for Reading {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TIMES: Times = Times {
        quick: true,
        missing: 5,
        frozen: 40,
        spike: 3,
        venting: 150,
        sustained: 15_000,
        end_of_phase: 50,
        disconnected: 150,
        unanswered: 40,
        stands: 20,
    };

    /// What is found in readings one after the other.
    fn feed(monitors: Monitors, readings: impl IntoIterator<Item = f32>) -> Option<Fault> {
        let mut sensor = Reading::new();
        readings
            .into_iter()
            .map(|reading| sensor.check(reading, true, monitors, &TIMES).fault)
            .fold(None, Option::or)
    }

    fn found(readings: impl IntoIterator<Item = f32>) -> Option<Fault> {
        feed(Monitors::ALL, readings)
    }

    /// A living sensor about a pressure: noise of 0.1 cmH2O on a grid of 0.07.
    fn alive(pressure: f32) -> impl Iterator<Item = f32> {
        (0..).map(move |n: u32| pressure + 0.07 * ((n * 7 % 5) as f32 - 2.0))
    }

    #[test]
    fn a_missing_reading_is_bridged_by_the_last_good_one() {
        let mut sensor = Reading::new();
        assert_eq!(sensor.check(f32::NAN, true, Monitors::ALL, &TIMES).pressure, None);
        sensor.check(12.0, true, Monitors::ALL, &TIMES);
        let bridged = sensor.check(f32::NAN, true, Monitors::ALL, &TIMES);
        assert_eq!(bridged, Believed { pressure: Some(12.0), fresh: false, fault: None });
    }

    #[test]
    fn missing_readings_are_a_fault_after_five_milliseconds_or_when_a_tenth_is_missing() {
        let nan = Some(Fault::ReadingNotANumber);
        assert_eq!((found([f32::NAN; 4]), found([f32::NAN; 5])), (None, nan));
        assert_eq!(found([f32::INFINITY; 5]), Some(Fault::ReadingOutOfRange));
        assert_eq!(found([-31.0; 5]), Some(Fault::ReadingOutOfRange));
        let every = |nth: usize| {
            let with_gaps = move |(n, p): (usize, f32)| if n.is_multiple_of(nth) { f32::NAN } else { p };
            found(alive(15.0).enumerate().map(with_gaps).take(3000))
        };
        assert_eq!((every(20), every(5)), (None, nan));
    }

    #[test]
    fn a_reading_that_stands_still_is_frozen_and_a_living_one_is_not() {
        assert_eq!(found(alive(5.0).take(3000)), None);
        assert_eq!(found([5.0; 40]), None);
        assert_eq!(found([5.0; 41]), Some(Fault::ReadingFrozen));
        assert_eq!(feed(Monitors::ALL.without(Fault::ReadingFrozen), [5.0; 3000]), None);
    }

    #[test]
    fn a_resting_ventilator_may_have_a_sensor_that_stands_still() {
        let mut sensor = Reading::new();
        for _ in 0..1000 {
            assert_eq!(sensor.check(0.0, false, Monitors::ALL, &TIMES).fault, None);
        }
    }

    #[test]
    fn jumps_are_not_believed() {
        let jumping = |n: usize, p: f32| if n.is_multiple_of(3) { p + 40.0 } else { p };
        let readings = || alive(5.0).enumerate().map(move |(n, p)| jumping(n, p)).take(200);
        assert_eq!(found(readings()), Some(Fault::ReadingJumps));
        let steep = (0..8).map(|n| 5.0 + 11.0 * n as f32);
        assert_eq!(found(steep), None, "as steep as a pressure can be");
    }

    #[test]
    fn noise_is_told_from_a_steep_pressure() {
        let noisy = (0..).map(|n: u32| 15.0 + 1.2 * ((n * 7 % 5) as f32 - 2.0)).take(200);
        assert_eq!(found(noisy), Some(Fault::ReadingNoisy));
        let swinging = alive(0.0).enumerate().map(|(n, p)| p + if n % 200 < 100 { 5.0 } else { 14.0 });
        assert_eq!(found(swinging.take(3000)), None);
    }

    proptest! {
        #[test]
        fn whatever_is_read_what_is_believed_is_a_number_in_range(
            readings in prop::collection::vec(prop::num::f32::ANY, 1..200),
        ) {
            let mut sensor = Reading::new();
            for reading in readings {
                let believed = sensor.check(reading, true, Monitors::ALL, &TIMES);
                if let Some(pressure) = believed.pressure {
                    prop_assert!((SENSOR_RANGE.0..=SENSOR_RANGE.1).contains(&pressure));
                }
            }
        }
    }
}
