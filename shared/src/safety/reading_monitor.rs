//! Checks that the pressure sensor works.
//!
//! An implausible reading is replaced by the last good one, for a few milliseconds. A working sensor never jumps. A reading
//! that repeats itself to the last bit while the pressure must change is frozen; while the pressure may stand still, a quiet
//! sensor with a coarse quantum repeats itself too.

use super::alarms::Fault;
use super::monitors::{Monitors, in_a_row, reads_quickly, ticks};

/// Range of readings that a working sensor can give, cmH2O. Fulfils: reading-range.
pub const SENSOR_RANGE: (f32, f32) = (-30.0, 110.0);
/// Largest change between two readings that the sensor's lag allows, cmH2O. Fulfils: reading-jumps.
pub const JUMP_MAX: f32 = 15.0;
/// Highest standard deviation of a working sensor's noise, cmH2O. Fulfils: reading-noisy.
pub const NOISE_MAX: f32 = 0.4;
/// Mean absolute second difference of white noise with a standard deviation of 1: `sqrt(6) sqrt(2 / pi)`.
pub const SECOND_DIFFERENCE: f32 = 1.954;
/// Weight of a new second difference in their mean.
pub const NOISE_SHARE: f32 = 0.02;
/// Good readings that cancel one missing reading.
pub const MAKE_UP: u32 = 9;
/// Time for which readings may be missing, s. Fulfils: reading-nan.
pub const MISSING: f32 = 0.005;
/// Time for which a reading may stay the same to the last bit although the pressure must change, s. Fulfils: reading-frozen.
pub const FROZEN: f32 = 0.06;
/// Time from which a reading stands still, s: longer than a working sensor repeats itself while the pressure changes.
const STANDS: f32 = 0.02;

/// Checks the sensor by its readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadingMonitor {
    /// Whether the control period is short enough to check noise and jumps.
    quick: bool,
    /// Lowest and highest reading, largest jump, cmH2O.
    range: (f32, f32),
    jump: f32,
    /// Highest mean absolute second difference, cmH2O.
    noise: f32,
    /// [`MISSING`], [`FROZEN`] and [`STANDS`] in ticks.
    missing: u32,
    frozen: u32,
    stands: u32,
}

/// State of the reading monitor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReadingState {
    last_good: Option<f32>,
    before: f32,
    /// Missing readings, each counted [`MAKE_UP`] times, minus the good readings since; no more than makes a fault, so that a sensor
    /// that was away for long owes no more than one that was away briefly.
    debt: u32,
    /// Number of missing readings by problem since the debt was last zero: not a number, out of range, jump.
    problems: [u32; 3],
    /// Consecutive ticks without a good reading.
    gap: u32,
    /// Ticks for which the reading has been the same, and how many of them it had to change in.
    same: u32,
    frozen: u32,
    second_difference: f32,
}

/// Result of a check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Believed {
    /// The pressure to control with, cmH2O; none before the first good reading.
    pub pressure: Option<f32>,
    /// Whether this is the reading itself and not a replacement.
    pub fresh: bool,
    /// Fault of the sensor, if one is detected.
    pub fault: Option<Fault>,
}

impl ReadingState {
    /// The last good reading, cmH2O.
    pub fn last_good(&self) -> Option<f32> {
        self.last_good
    }

    /// Whether the reading has just changed.
    pub fn changed(&self) -> bool {
        self.same == 0
    }

    /// The most frequent problem.
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
}

impl ReadingMonitor {
    /// A monitor for a control period in microseconds that reports the enabled findings only.
    pub fn new(period_us: u32, enabled: Monitors) -> Self {
        let quick = reads_quickly(period_us);
        let (lowest, highest) = SENSOR_RANGE;
        let out_of_range = |bound| enabled.highest(Fault::ReadingOutOfRange, bound);
        Self {
            quick,
            range: (-out_of_range(-lowest), out_of_range(highest)),
            jump: if quick { enabled.highest(Fault::ReadingJumps, JUMP_MAX) } else { f32::INFINITY },
            noise: enabled.highest(Fault::ReadingNoisy, NOISE_MAX * SECOND_DIFFERENCE),
            missing: ticks(MISSING, period_us),
            frozen: enabled.limit(Fault::ReadingFrozen, ticks(FROZEN, period_us)),
            stands: ticks(STANDS, period_us),
        }
    }

    /// Whether a sensor stands still.
    pub fn stands(&self, state: &ReadingState) -> bool {
        state.same >= self.stands
    }

    /// Checks one reading. `breathes`: a breath runs, so noise and frozen readings are checked. `moves`: the pressure must
    /// change.
    #[inline]
    pub fn check(&self, state: &mut ReadingState, reading: f32, breathes: bool, moves: bool) -> Believed {
        if let Some(problem) = self.problem(state, reading) {
            return self.bridge(state, problem);
        }
        debug_assert!(!reading.is_nan(), "what is believed is a number");
        state.debt = state.debt.saturating_sub(1);
        if state.debt == 0 {
            state.problems = [0; 3];
        }
        let fault = self.good(state, reading, breathes, moves);
        Believed { pressure: Some(reading), fresh: true, fault }
    }

    /// Reason why a reading counts as missing, if there is one.
    fn problem(&self, state: &ReadingState, reading: f32) -> Option<Fault> {
        if reading.is_nan() {
            return Some(Fault::ReadingNotANumber);
        }
        let in_range = reading >= self.range.0 && reading <= self.range.1;
        if !in_range {
            return Some(Fault::ReadingOutOfRange);
        }
        let jump = state.last_good.map_or(0.0, |last| (reading - last).abs());
        // The longer the gap, the further the pressure may have moved.
        let possible = self.jump * (state.gap + 1) as f32;
        (jump > possible).then_some(Fault::ReadingJumps)
    }

    fn bridge(&self, state: &mut ReadingState, problem: Fault) -> Believed {
        state.gap = state.gap.saturating_add(1);
        let enough = self.missing * MAKE_UP;
        state.debt = (state.debt + MAKE_UP).min(enough);
        let [no_number, out_of_range, jumps] = &mut state.problems;
        let count = match problem {
            Fault::ReadingNotANumber => no_number,
            Fault::ReadingOutOfRange => out_of_range,
            _ => jumps,
        };
        *count = count.saturating_add(1);
        let fault = (state.debt >= enough).then(|| state.main_problem());
        Believed { pressure: state.last_good, fresh: false, fault }
    }

    fn good(&self, state: &mut ReadingState, reading: f32, breathes: bool, moves: bool) -> Option<Fault> {
        let (last, before) = (state.last_good.replace(reading), state.before);
        state.before = last.unwrap_or(reading);
        let (Some(last), 0, true, true) = (last, state.gap, breathes, self.quick) else {
            (state.gap, state.same, state.frozen, state.before) = (0, 0, 0, reading);
            return None;
        };
        let same = reading.to_bits() == last.to_bits();
        state.same = in_a_row(state.same, same);
        // Once frozen it stays so until it changes.
        state.frozen = if same { state.frozen.saturating_add(u32::from(moves)) } else { 0 };
        debug_assert!(state.frozen <= state.same, "only a reading that stays the same is frozen");
        let second_difference = (reading - 2.0 * last + before).abs();
        state.second_difference += NOISE_SHARE * (second_difference - state.second_difference);
        if state.frozen >= self.frozen {
            return Some(Fault::ReadingFrozen);
        }
        (state.second_difference > self.noise).then_some(Fault::ReadingNoisy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const PERIOD_US: u32 = 1000;

    /// A monitor and its state before the first reading.
    fn monitor(enabled: Monitors) -> (ReadingMonitor, ReadingState) {
        (ReadingMonitor::new(PERIOD_US, enabled), ReadingState::default())
    }

    /// The first fault found in a sequence of readings.
    fn feed(enabled: Monitors, readings: impl IntoIterator<Item = f32>) -> Option<Fault> {
        let (monitor, mut state) = monitor(enabled);
        readings
            .into_iter()
            .map(|reading| monitor.check(&mut state, reading, true, true).fault)
            .fold(None, Option::or)
    }

    fn found(readings: impl IntoIterator<Item = f32>) -> Option<Fault> {
        feed(Monitors::ALL, readings)
    }

    /// Readings of a working sensor around a pressure: noise of 0.1 cmH2O on a grid of 0.07.
    fn alive(pressure: f32) -> impl Iterator<Item = f32> {
        (0..).map(move |n: u32| pressure + 0.07 * ((n * 7 % 5) as f32 - 2.0))
    }

    #[test]
    fn a_missing_reading_is_bridged_by_the_last_good_one() {
        let (monitor, mut state) = monitor(Monitors::ALL);
        assert_eq!(monitor.check(&mut state, f32::NAN, true, true).pressure, None);
        monitor.check(&mut state, 12.0, true, true);
        let bridged = monitor.check(&mut state, f32::NAN, true, true);
        assert_eq!(bridged, Believed { pressure: Some(12.0), fresh: false, fault: None });
    }

    /// Verifies: reading-nan.
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

    /// Faults in 3 s with one reading in so many missing, after the sensor was away and then sound for some milliseconds.
    fn faults_after(away: usize, sound: usize, every: usize) -> usize {
        let (monitor, mut state) = monitor(Monitors::ALL);
        let mut check = |reading| monitor.check(&mut state, reading, true, true).fault.is_some();
        (0..away).for_each(|_| _ = check(f32::NAN));
        alive(15.0).take(sound).for_each(|reading| _ = check(reading));
        let later = alive(15.0).take(3000).enumerate();
        later.filter(|(n, reading)| check(if n.is_multiple_of(every) { f32::NAN } else { *reading })).count()
    }

    #[test]
    fn a_sensor_that_was_away_for_long_owes_no_more_than_one_that_was_away_briefly() {
        let sound_again = (super::super::source::SOUND_AGAIN * 1000.0) as usize;
        for away in [5, 100, 60_000] {
            for sound in [MAKE_UP as usize * 5, sound_again] {
                assert_eq!(faults_after(away, sound, 20), 0, "away for {away} ms, sound for {sound}");
            }
            assert!(faults_after(away, sound_again, 5) > 0, "and it is watched as before");
        }
    }

    #[test]
    fn the_problem_that_came_most_often_is_told_and_good_readings_make_up_for_old_ones() {
        let (nan, far) = (f32::NAN, 200.0);
        assert_eq!(found([far, far, far, 5.0, nan, nan, nan]), Some(Fault::ReadingOutOfRange));
        assert_eq!(found([far, far, 5.0, nan, nan, nan, nan]), Some(Fault::ReadingNotANumber));
        let made_up = [nan; 4].into_iter().chain(alive(5.0).take(36));
        assert_eq!(found(made_up.chain([nan, nan, far, far, far])), Some(Fault::ReadingOutOfRange));
        assert_eq!(found([5.0, far, far, 110.0, 110.0, 110.0]), Some(Fault::ReadingJumps));
    }

    /// Verifies: reading-jumps.
    #[test]
    fn a_reading_may_jump_by_the_highest_jump_for_each_millisecond_since_the_last() {
        let believed = |readings: &[f32]| {
            let (monitor, mut state) = monitor(Monitors::ALL);
            readings
                .iter()
                .map(|reading| monitor.check(&mut state, *reading, true, true).fresh)
                .collect::<Vec<_>>()
        };
        assert_eq!(believed(&[0.0, JUMP_MAX]), [true, true]);
        assert_eq!(believed(&[0.0, JUMP_MAX + 0.1]), [true, false]);
        assert_eq!(believed(&[10.0, f32::NAN, 10.0 - 2.0 * JUMP_MAX]), [true, false, true]);
        assert_eq!(believed(&[10.0, f32::NAN, 9.9 - 2.0 * JUMP_MAX]), [true, false, false]);
    }

    /// Verifies: reading-noisy.
    #[test]
    fn noise_at_its_bound_is_that_of_a_sound_sensor() {
        let (monitor, state) = monitor(Monitors::ALL);
        let noise = NOISE_MAX * SECOND_DIFFERENCE;
        let at_the_bound = |second_difference| {
            let mut state = ReadingState { last_good: Some(0.0), second_difference, ..state };
            monitor.check(&mut state, noise, true, true).fault
        };
        assert_eq!((at_the_bound(noise), at_the_bound(1.01 * noise)), (None, Some(Fault::ReadingNoisy)));
    }

    /// Verifies: reading-frozen.
    #[test]
    fn a_reading_that_stands_still_while_the_pressure_must_change_is_frozen() {
        assert_eq!(found(alive(5.0).take(3000)), None);
        assert_eq!(found([5.0; 60]), None);
        assert_eq!(found([5.0; 61]), Some(Fault::ReadingFrozen));
        assert_eq!(feed(Monitors::ALL.without(Fault::ReadingFrozen), [5.0; 3000]), None);
        let changes = (0..3000).map(|n| if n % 60 == 0 { 5.1 } else { 5.0 });
        assert_eq!(found(changes), None);
    }

    #[test]
    fn only_the_ticks_count_in_which_the_pressure_must_change() {
        let (monitor, mut state) = monitor(Monitors::ALL);
        let mut fault = |moves| monitor.check(&mut state, 5.0, true, moves).fault;
        assert!((0..3000).all(|_| fault(false).is_none()), "a quiet sensor at a constant pressure");
        assert!((0..59).all(|_| fault(true).is_none() && fault(false).is_none()));
        assert_eq!(fault(true), Some(Fault::ReadingFrozen));
        assert_eq!(fault(false), Some(Fault::ReadingFrozen), "until it changes");
        assert_eq!(monitor.check(&mut state, 5.1, true, true).fault, None);
    }

    #[test]
    fn a_reading_stands_still_after_twenty_repetitions() {
        let (monitor, mut state) = monitor(Monitors::ALL);
        for repetitions in 0..30 {
            monitor.check(&mut state, 5.0, true, false);
            assert_eq!(monitor.stands(&state), repetitions >= 20, "{repetitions}");
            assert_eq!(state.changed(), repetitions == 0);
        }
    }

    #[test]
    fn a_resting_ventilator_may_have_a_sensor_that_stands_still() {
        let (monitor, mut state) = monitor(Monitors::ALL);
        for _ in 0..1000 {
            assert_eq!(monitor.check(&mut state, 0.0, false, true).fault, None);
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
    fn noise_is_distinguished_from_a_steep_pressure() {
        let noisy = (0..).map(|n: u32| 15.0 + 1.2 * ((n * 7 % 5) as f32 - 2.0)).take(200);
        assert_eq!(found(noisy), Some(Fault::ReadingNoisy));
        let swinging = alive(0.0).enumerate().map(|(n, p)| p + if n % 200 < 100 { 5.0 } else { 14.0 });
        assert_eq!(found(swinging.take(3000)), None);
    }

    proptest! {
        /// Whatever the sensor did before: once nothing is owed, fewer missing readings than make a fault are none.
        #[test]
        fn few_missing_readings_are_no_fault_once_the_sensor_has_made_up_for_all(
            before in prop::collection::vec((prop_oneof![Just(f32::NAN), Just(500.0f32), Just(15.0f32)], 1usize..500), 0..20),
            missing in 0usize..5,
        ) {
            let (monitor, mut state) = monitor(Monitors::ALL);
            for (reading, ticks) in before {
                (0..ticks).for_each(|_| _ = monitor.check(&mut state, reading, true, true));
            }
            alive(15.0).take(45).for_each(|reading| _ = monitor.check(&mut state, reading, true, true));
            for _ in 0..missing {
                prop_assert_eq!(monitor.check(&mut state, f32::NAN, true, true).fault, None);
            }
        }

        #[test]
        fn whatever_is_read_what_is_believed_is_a_number_in_range(
            readings in prop::collection::vec(prop::num::f32::ANY, 1..200),
        ) {
            let (monitor, mut state) = monitor(Monitors::ALL);
            for reading in readings {
                let believed = monitor.check(&mut state, reading, true, true);
                if let Some(pressure) = believed.pressure {
                    prop_assert!((SENSOR_RANGE.0..=SENSOR_RANGE.1).contains(&pressure));
                }
            }
        }
    }
}
