//! What a controller remembers of earlier breaths: the error and the command over the time of the inspiration.
//!
//! Breaths repeat, so the errors that remain are mostly the same in the next breath: they come from the unit and the lung, which
//! no controller knows in advance. Both signals are averaged over bins of a few milliseconds. The profile of a breath that ran
//! undisturbed enters a mean over breaths ([`Lesson::Adopt`]), which removes noise; error and command are averaged alike, so the
//! mean error is still the one that belongs to the mean command. The next breath looks ahead in the profile, because the valve acts
//! late.
//!
//! A breath whose error surprises is the first one of a changed lung, or disturbed in a way that nothing else has noticed. What was
//! remembered may be that of another lung, so all of it is forgotten: the next breath runs like a first one, which the controller
//! is trained for, and the breath after it already has a sound memory.

use serde::{Deserialize, Serialize};

use super::features::ERROR_SCALE;
use crate::math;

/// Number of bins of a profile; after the last one, a profile keeps its value.
pub const BINS: usize = 128;
/// Duration of a bin, s: short beside the valve's lag.
const BIN_S: f32 = 0.008;
/// How far ahead, in bins, the next breath reads the remembered error: about the dead time and lag of a valve.
pub const ERRORS_AHEAD: [usize; 5] = [1, 3, 5, 7, 10];
/// The same for the remembered command.
pub const COMMANDS_AHEAD: [usize; 2] = [0, 3];
/// Number of values that a breath recalls: errors, commands, and whether there is anything to recall.
pub const RECALLED: usize = ERRORS_AHEAD.len() + COMMANDS_AHEAD.len() + 1;
/// Bins that an inspiration must fill to be remembered.
pub const LEAST_BINS: usize = 8;
/// Weight of the newest breath in the mean over breaths.
pub const NEWEST: f32 = 0.5;
/// Mean absolute difference to the remembered error, over the bins, from which a breath surprises: 0.5 cmH2O, in the scaled units
/// of the features.
pub const SURPRISE: f32 = 0.5 / ERROR_SCALE;
/// Adopted breaths before which no breath counts as a surprise: a controller that is still learning changes its errors by itself.
pub const LEARNING: u8 = 4;

/// What to do with the breath that has just ended, or what was done with it. The order of the variants is part of the flight
/// recorder's format: append only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Lesson {
    /// Remember it: it ran undisturbed.
    #[default]
    Adopt,
    /// Keep the earlier ones only: it was disturbed, by an effort for example.
    Discard,
    /// Forget all: the next breath has other settings, or another lung.
    Forget,
}

/// Error and command over the time of an inspiration, in the scaled units of the features.
#[derive(Clone, Debug, PartialEq)]
struct Profile {
    bins: [[f32; 2]; BINS],
    /// Number of bins in use.
    filled: usize,
}

impl Profile {
    const fn empty() -> Self {
        Self { bins: [[0.0; 2]; BINS], filled: 0 }
    }
}

/// Memory of earlier breaths, and the profile of the running one.
///
/// Bin by bin, the running breath is averaged with what is remembered into a second profile. At its end the two change places, or
/// not: either way takes a few instructions.
#[derive(Clone, Debug, PartialEq)]
pub struct BreathMemory {
    profiles: [Profile; 2],
    /// Whether the second profile is the remembered one; the other one is that of the running breath.
    second: bool,
    /// Sums over the running bin, and the ticks in it.
    sums: [f32; 2],
    ticks: u32,
    /// Sum over the bins of the difference between the running error and the remembered one.
    difference: f32,
    /// Whether all values of the running breath are finite.
    finite: bool,
    /// Breaths adopted since all was forgotten, up to [`LEARNING`].
    adopted: u8,
}

impl Default for BreathMemory {
    fn default() -> Self {
        Self::new()
    }
}

impl BreathMemory {
    /// Nothing remembered.
    pub const fn new() -> Self {
        Self {
            profiles: [Profile::empty(), Profile::empty()],
            second: false,
            sums: [0.0; 2],
            ticks: 0,
            difference: 0.0,
            finite: true,
            adopted: 0,
        }
    }

    fn mean(&self) -> &Profile {
        &self.profiles[usize::from(self.second)]
    }

    /// Ends the running inspiration, or forgets; returns what has become of the breath.
    pub fn learn(&mut self, lesson: Lesson) -> Lesson {
        let filled = self.profiles[usize::from(!self.second)].filled;
        let sound = self.finite && filled >= LEAST_BINS;
        let surprises = self.adopted >= LEARNING && self.difference >= SURPRISE * filled as f32;
        let learned = match lesson {
            Lesson::Adopt if !sound => Lesson::Discard,
            Lesson::Adopt if surprises => Lesson::Forget,
            lesson => lesson,
        };
        match learned {
            Lesson::Adopt => {
                self.adopted = (self.adopted + 1).min(LEARNING);
                self.second = !self.second;
            }
            Lesson::Discard => {}
            Lesson::Forget => (self.adopted, self.profiles[usize::from(self.second)].filled) = (0, 0),
        }
        debug_assert!(self.adopted <= LEARNING && filled <= BINS);
        self.profiles[usize::from(!self.second)].filled = 0;
        (self.sums, self.ticks, self.difference, self.finite) = ([0.0; 2], 0, 0.0, true);
        learned
    }

    /// Breaths adopted since all was forgotten, at most [`LEARNING`].
    pub fn adopted(&self) -> u8 {
        self.adopted
    }

    /// Records a tick of the running inspiration: error and command in scaled units.
    #[inline]
    pub fn record(&mut self, bin_ticks: u32, error: f32, command: f32) {
        self.sums = [self.sums[0] + error, self.sums[1] + command];
        self.ticks += 1;
        if self.ticks >= bin_ticks {
            let share = 1.0 / bin_ticks as f32;
            self.fill(self.sums.map(|sum| share * sum));
            (self.sums, self.ticks) = ([0.0; 2], 0);
        }
        debug_assert!(self.ticks < bin_ticks, "a full bin is closed");
    }

    /// Adds a bin to the profile of the running breath.
    fn fill(&mut self, new: [f32; 2]) {
        let [first, second] = &mut self.profiles;
        let (mean, running) = if self.second { (&*second, first) } else { (&*first, second) };
        let bin = running.filled;
        let Some(place) = running.bins.get_mut(bin) else { return };
        *place = new;
        running.filled = bin + 1;
        let known = mean.bins.get(bin).filter(|_| bin < mean.filled);
        let old = known.copied().unwrap_or(new);
        self.finite &= new.iter().all(|value| value.is_finite());
        self.difference += (new[0] - old[0]).abs();
        if known.is_some() {
            *place = [0, 1].map(|n| old[n] + NEWEST * (new[n] - old[n]));
        }
    }

    /// What is remembered of the time after a tick of the inspiration: the error at each of [`ERRORS_AHEAD`], the command at each of
    /// [`COMMANDS_AHEAD`], then one; all zero if nothing is remembered.
    #[inline]
    pub fn recall(&self, tick: u32, bin_ticks: u32) -> [f32; RECALLED] {
        let mut recalled = [0.0; RECALLED];
        let mean = self.mean();
        let Some(last) = mean.filled.checked_sub(1) else { return recalled };
        let Place { bin, share } = Place::of(tick, bin_ticks);
        let at = |ahead: usize, signal: usize| {
            let entry = |bin: usize| mean.bins[bin.min(last).min(BINS - 1)][signal];
            let first = entry(bin + ahead);
            first + share * (entry(bin + ahead + 1) - first)
        };
        let errors = ERRORS_AHEAD.map(|ahead| at(ahead, 0));
        let commands = COMMANDS_AHEAD.map(|ahead| at(ahead, 1));
        for (place, value) in recalled.iter_mut().zip(errors.iter().chain(&commands).chain(&[1.0])) {
            *place = *value;
        }
        recalled
    }
}

/// A position between the middles of two bins.
struct Place {
    /// The earlier bin.
    bin: usize,
    /// Weight of the later bin.
    share: f32,
}

impl Place {
    /// The position of a tick.
    #[inline]
    fn of(tick: u32, bin_ticks: u32) -> Self {
        let since_middle = tick.saturating_sub(bin_ticks / 2);
        let share = (since_middle % bin_ticks) as f32 / bin_ticks as f32;
        Self { bin: (since_middle / bin_ticks) as usize, share }
    }
}

/// Ticks of a bin for a control period in microseconds; at least one.
pub fn bin_ticks(period_us: u32) -> u32 {
    math::ticks(BIN_S, period_us).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::DEFAULT_PERIOD_US;
    use proptest::prelude::*;

    const BIN: u32 = 8;

    /// Records a breath of constant error and command, scaled.
    fn breathe(memory: &mut BreathMemory, ticks: u32, error: f32, command: f32) {
        (0..ticks).for_each(|_| memory.record(BIN, error, command));
    }

    /// A memory that has adopted this number of breaths with the same error.
    fn after(breaths: usize, error: f32) -> BreathMemory {
        let mut memory = BreathMemory::new();
        for _ in 0..breaths {
            breathe(&mut memory, 1000, error, 0.5);
            assert_eq!(memory.learn(Lesson::Adopt), Lesson::Adopt);
        }
        memory
    }

    /// Remembered error and command at a tick, without looking ahead.
    fn at(memory: &BreathMemory, tick: u32) -> [f32; 2] {
        let recalled = memory.recall(tick, BIN);
        // Ahead by a bin.
        [recalled[0], recalled[ERRORS_AHEAD.len()]]
    }

    fn bits(memory: &BreathMemory, tick: u32) -> [u32; RECALLED] {
        memory.recall(tick, BIN).map(f32::to_bits)
    }

    #[track_caller]
    fn near(value: f32, wanted: f32) {
        assert!((value - wanted).abs() < 1e-5, "{value}, not {wanted}");
    }

    #[test]
    fn a_bin_has_eight_milliseconds_at_one_kilohertz_and_never_less_than_a_tick() {
        assert_eq!([DEFAULT_PERIOD_US, 2000, 30_000].map(bin_ticks), [8, 4, 1]);
    }

    #[test]
    fn nothing_is_recalled_before_a_breath_was_adopted() {
        let mut memory = BreathMemory::new();
        breathe(&mut memory, 1000, 0.3, 0.5);
        assert_eq!(bits(&memory, 100), [0; RECALLED]);
        assert_eq!(memory.learn(Lesson::Adopt), Lesson::Adopt);
        let recalled = memory.recall(100, BIN);
        recalled[..ERRORS_AHEAD.len()].iter().for_each(|error| near(*error, 0.3));
        assert_eq!(recalled[ERRORS_AHEAD.len()..], [0.5, 0.5, 1.0]);
    }

    #[test]
    fn a_breath_is_recalled_ahead_of_its_time_between_the_middles_of_its_bins() {
        let mut memory = BreathMemory::new();
        for tick in 0..1000 {
            memory.record(BIN, tick as f32, -(tick as f32));
        }
        memory.learn(Lesson::Adopt);
        // The middle of bin n is at tick 8 n + 3.5, and the reading takes it for that at 8 n + 4.
        let recalled = memory.recall(104, BIN);
        for (n, ahead) in ERRORS_AHEAD.iter().enumerate() {
            near(recalled[n], 103.5 + (8 * ahead) as f32);
        }
        near(recalled[ERRORS_AHEAD.len()], -103.5);
        near(recalled[ERRORS_AHEAD.len() + 1], -127.5);
        near(memory.recall(106, BIN)[0], 113.5);
        near(memory.recall(0, BIN)[0], 11.5);
        near(memory.recall(3, BIN)[0], 11.5);
    }

    #[test]
    fn after_the_end_of_a_breath_its_last_bin_is_recalled() {
        let mut memory = BreathMemory::new();
        for tick in 0..400 {
            memory.record(BIN, if tick < 392 { 0.1 } else { 0.9 }, 0.0);
        }
        memory.learn(Lesson::Adopt);
        for tick in [396, 500, 5000, u32::MAX] {
            near(memory.recall(tick, BIN)[0], 0.9);
        }
    }

    #[test]
    fn an_inspiration_longer_than_the_memory_keeps_its_beginning() {
        let mut memory = BreathMemory::new();
        for tick in 0..5000 {
            memory.record(BIN, if tick < (BINS as u32) * BIN { 0.2 } else { 7.0 }, 0.0);
        }
        memory.learn(Lesson::Adopt);
        near(memory.recall(5000, BIN)[4], 0.2);
    }

    #[test]
    fn an_inspiration_too_short_to_learn_from_is_left_out() {
        let mut memory = BreathMemory::new();
        breathe(&mut memory, 8 * BIN - 1, 0.3, 0.5);
        assert_eq!(memory.learn(Lesson::Adopt), Lesson::Discard);
        breathe(&mut memory, 8 * BIN, 0.3, 0.5);
        assert_eq!(memory.learn(Lesson::Adopt), Lesson::Adopt);
    }

    #[test]
    fn breaths_are_averaged_and_the_newest_counts_half() {
        let mut memory = after(1, 0.1);
        breathe(&mut memory, 1000, 0.12, 0.7);
        memory.learn(Lesson::Adopt);
        let [error, command] = at(&memory, 300);
        near(error, 0.11);
        near(command, 0.6);
    }

    #[test]
    fn an_unfinished_breath_changes_nothing_that_is_recalled() {
        let mut memory = after(2, 0.1);
        let before = bits(&memory, 300);
        breathe(&mut memory, 700, 0.9, 0.9);
        assert_eq!(bits(&memory, 300), before);
        assert_eq!(memory.learn(Lesson::Discard), Lesson::Discard);
        assert_eq!(bits(&memory, 300), before);
        // It has left nothing to the next breath either.
        breathe(&mut memory, 1000, 0.1, 0.5);
        memory.learn(Lesson::Adopt);
        near(at(&memory, 300)[0], 0.1);
    }

    #[test]
    fn what_is_forgotten_is_not_recalled_and_has_no_part_in_the_next_mean() {
        let mut memory = after(5, 0.1);
        assert_eq!(memory.learn(Lesson::Forget), Lesson::Forget);
        assert_eq!(bits(&memory, 300), [0; RECALLED]);
        breathe(&mut memory, 1000, 0.4, 0.2);
        assert_eq!(memory.learn(Lesson::Adopt), Lesson::Adopt);
        near(at(&memory, 300)[0], 0.4);
    }

    #[test]
    fn a_breath_that_surprises_makes_the_memory_forget() {
        let mut memory = after(usize::from(LEARNING), 0.1);
        breathe(&mut memory, 1000, 0.1 - 0.99 * SURPRISE, 0.5);
        assert_eq!(memory.learn(Lesson::Adopt), Lesson::Adopt, "less than that does not surprise");
        let mut memory = after(usize::from(LEARNING), 0.1);
        breathe(&mut memory, 1000, 0.1 + 1.01 * SURPRISE, 0.5);
        assert_eq!(memory.learn(Lesson::Adopt), Lesson::Forget);
        assert_eq!(bits(&memory, 300), [0; RECALLED]);
        // The controller starts to learn again, so that nothing surprises for a while.
        for error in [0.9, 0.4, 0.1] {
            breathe(&mut memory, 1000, error, 0.8);
            assert_eq!(memory.learn(Lesson::Adopt), Lesson::Adopt);
        }
    }

    #[test]
    fn a_disturbed_breath_does_not_surprise() {
        let mut memory = after(usize::from(LEARNING), 0.1);
        breathe(&mut memory, 1000, 0.9, 0.5);
        assert_eq!(memory.learn(Lesson::Discard), Lesson::Discard);
        near(at(&memory, 300)[0], 0.1);
    }

    #[test]
    fn nothing_surprises_while_the_controller_is_still_learning() {
        let mut memory = BreathMemory::new();
        for error in [0.9, 0.4, 0.9, 0.4] {
            breathe(&mut memory, 1000, error, 0.5);
            assert_eq!(memory.learn(Lesson::Adopt), Lesson::Adopt);
        }
        breathe(&mut memory, 1000, 2.0, 0.5);
        assert_eq!(memory.learn(Lesson::Adopt), Lesson::Forget);
    }

    #[test]
    fn a_breath_with_a_value_that_is_not_finite_is_never_adopted() {
        for breaths in [0, 1, usize::from(LEARNING)] {
            for (error, command) in [(f32::NAN, 0.5), (f32::INFINITY, 0.5), (0.1, f32::NAN)] {
                let mut memory = after(breaths, 0.1);
                breathe(&mut memory, 500, 0.1, 0.5);
                breathe(&mut memory, BIN, error, command);
                breathe(&mut memory, 400, 0.1, 0.5);
                assert_eq!(memory.learn(Lesson::Adopt), Lesson::Discard);
                assert!(memory.recall(500, BIN).iter().all(|value| value.is_finite()));
            }
        }
    }

    proptest! {
        #[test]
        fn whatever_is_recorded_and_learned_nothing_panics_and_recalled_values_stay_within_the_recorded_ones(
            breaths in prop::collection::vec((0u32..2000, -2.0f32..2.0, 0usize..3), 1..12),
            tick: u32,
        ) {
            let mut memory = BreathMemory::new();
            let lessons = [Lesson::Adopt, Lesson::Discard, Lesson::Forget];
            let (mut low, mut high) = (0.0_f32, 0.0_f32);
            for (ticks, error, lesson) in breaths {
                breathe(&mut memory, ticks, error, error);
                memory.learn(lessons[lesson]);
                (low, high) = (low.min(error), high.max(error));
                let recalled = memory.recall(tick, BIN);
                prop_assert!(recalled[..RECALLED - 1].iter().all(|v| (low - 1e-4..=high + 1e-4).contains(v)));
            }
        }
    }
}
