//! What a controller remembers of earlier breaths: the error and the command over the time of the inspiration.
//!
//! Breaths repeat, so the errors that remain are mostly the same in the next breath: they come from the unit and the lung, which
//! no controller knows in advance. Both signals are averaged over bins, of a few milliseconds while the pressure rises and of many on
//! the plateau, so that the longest inspiration fits. The profile of a breath that ran
//! undisturbed enters a mean over breaths ([`Lesson::Adopt`]), which removes noise; error and command are averaged alike, so the
//! mean error is still the one that belongs to the mean command. The next breath looks ahead in the profile, because the valve acts
//! late.
//!
//! A breath whose error surprises is the first one of a changed lung, or disturbed in a way that nothing else has noticed. What was
//! remembered may be that of another lung, so all of it is forgotten: the next breath runs like a first one, which the controller
//! is trained for, and the breath after it already has a sound memory. Other settings make it forget too, except for a small step of
//! PIP or PEEP alone ([`outlasts`]).

use serde::{Deserialize, Serialize};

use super::features::ERROR_SCALE;
use crate::math;
use crate::settings::Settings;

/// Number of bins of a profile; after the last one, a profile keeps its value.
pub const BINS: usize = 128;
/// Duration of the shortest bins, s: short beside the valve's lag.
const BIN_S: f32 = 0.008;
/// Bins of one width.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    /// Number of its bins.
    pub bins: usize,
    /// Their width, in shortest bins.
    pub width: u32,
}
/// The bins in order: 0.51 s of 8 ms, 0.51 s of 16 ms and 4.1 s of 128 ms at 1 kHz.
pub const SECTIONS: [Section; 3] =
    [Section { bins: 64, width: 1 }, Section { bins: 32, width: 2 }, Section { bins: 32, width: 16 }];
/// How far ahead, in shortest bins, the next breath reads the remembered error: about the dead time and lag of a valve.
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
/// Largest step of PIP and of PEEP that the memory outlasts, cmH2O. On the family `adult`, a breath after a step of PIP from 20 by 1 is
/// 17 % worse than later ones if all is forgotten and 3 % if it is remembered, by 2 it is 17 and 7 %; from about 4 on, both are equal.
pub const SMALL_STEP: f32 = 3.0;
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

/// Whether what was learned with the old settings helps with the new ones: only PIP and PEEP differ, by a small step each.
pub fn outlasts(old: &Settings, new: &Settings) -> bool {
    let small = |from: f32, to: f32| (to - from).abs() <= SMALL_STEP;
    let others_stay = Settings { pip: old.pip, peep: old.peep, ..*new } == *old;
    others_stay && small(old.pip, new.pip) && small(old.peep, new.peep)
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
    /// Width of the running bin, in shortest bins.
    width: u32,
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
            width: SECTIONS[0].width,
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
        (self.sums, self.ticks, self.width) = ([0.0; 2], 0, SECTIONS[0].width);
        (self.difference, self.finite) = (0.0, true);
        learned
    }

    /// Breaths adopted since all was forgotten, at most [`LEARNING`].
    pub fn adopted(&self) -> u8 {
        self.adopted
    }

    /// Remembered error and command of a bin, scaled; past what is remembered, those of the last bin, and zero if nothing is.
    pub fn remembered(&self, bin: usize) -> [f32; 2] {
        let mean = self.mean();
        mean.filled.checked_sub(1).map_or([0.0; 2], |last| mean.bins[bin.min(last).min(BINS - 1)])
    }

    /// Records a tick of the running inspiration: error and command in scaled units.
    #[inline]
    pub fn record(&mut self, bin_ticks: u32, error: f32, command: f32) {
        self.sums = [self.sums[0] + error, self.sums[1] + command];
        self.ticks += 1;
        let bin_ticks = bin_ticks * self.width;
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
        self.width = width(bin + 1);
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
        if mean.filled == 0 {
            return recalled;
        }
        let now = since_first(tick, bin_ticks);
        let at = |ahead: usize, signal: usize| {
            let Place { bin, share } = Place::at(now + ahead as f32);
            let [first, second] = [bin, bin + 1].map(|bin| self.remembered(bin)[signal]);
            first + share * (second - first)
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
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The earlier bin; may be past the last one.
    pub bin: usize,
    /// Weight of the later bin.
    pub share: f32,
}

/// Time of a tick since the middle of the first bin, in shortest bins; not before it.
#[inline]
pub fn since_first(tick: u32, bin_ticks: u32) -> f32 {
    tick.saturating_sub(bin_ticks / 2) as f32 / bin_ticks as f32
}

/// Equally distant middles of bins.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// The first of them, in shortest bins since the middle of the first bin.
    pub from: f32,
    /// Its bin.
    pub bin: usize,
    /// Bins of the profile per shortest bin.
    pub rate: f32,
}

/// The middles of all bins, in order: of the sections, and of the gaps between them.
pub const PIECES: [Piece; 2 * SECTIONS.len() - 1] = pieces();

const fn pieces() -> [Piece; 2 * SECTIONS.len() - 1] {
    let mut pieces = [Piece { from: 0.0, bin: 0, rate: 1.0 }; 2 * SECTIONS.len() - 1];
    let (mut n, mut bin, mut start) = (0, 0, 0);
    while n < SECTIONS.len() {
        let Section { bins, width } = SECTIONS[n];
        // A bin of width w that begins s shortest bins after the first one has its middle at s + (w - 1) / 2.
        let (first, width) = (start as f32 + 0.5 * (width - 1) as f32, width as f32);
        if n > 0 {
            let before = pieces[2 * n - 2];
            let last = before.from + (bin - 1 - before.bin) as f32 / before.rate;
            pieces[2 * n - 1] = Piece { from: last, bin: bin - 1, rate: 1.0 / (first - last) };
        }
        pieces[2 * n] = Piece { from: first, bin, rate: 1.0 / width };
        (bin, start) = (bin + bins, start + bins * SECTIONS[n].width as usize);
        n += 1;
    }
    assert!(bin == BINS, "the sections fill the profile");
    pieces
}

impl Place {
    /// The position at this time since the middle of the first bin, in shortest bins.
    #[inline]
    pub fn at(time: f32) -> Self {
        let mut piece = PIECES[0];
        for next in &PIECES[1..] {
            if time >= next.from {
                piece = *next;
            }
        }
        let bins = (time - piece.from) * piece.rate;
        let whole = bins as u32;
        Self { bin: piece.bin + whole as usize, share: bins - whole as f32 }
    }
}

/// Width of a bin, in shortest bins; past the end, of the last one.
fn width(bin: usize) -> u32 {
    let mut left = bin;
    for Section { bins, width } in SECTIONS {
        if left < bins {
            return width;
        }
        left -= bins;
    }
    SECTIONS[SECTIONS.len() - 1].width
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
        let longest: u32 = SECTIONS.iter().map(|section| section.bins as u32 * section.width * BIN).sum();
        assert_eq!(longest, 5120);
        for tick in 0..7000 {
            memory.record(BIN, if tick < longest { 0.2 } else { 7.0 }, 0.0);
        }
        memory.learn(Lesson::Adopt);
        near(memory.recall(7000, BIN)[4], 0.2);
    }

    #[test]
    fn bins_of_every_width_are_recalled_between_their_middles() {
        let mut memory = BreathMemory::new();
        for tick in 0..5120 {
            memory.record(BIN, tick as f32, 0.0);
        }
        memory.learn(Lesson::Adopt);
        for tick in 4..5000_u32 {
            // Ahead by a shortest bin; from the middle of the last bin on, nothing is known.
            let wanted = (tick as f32 - 0.5 + 8.0).min(5120.0 - 64.5);
            assert!((memory.recall(tick, BIN)[0] - wanted).abs() < 1e-2, "tick {tick}");
        }
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
        breathe(&mut memory, 1000, 0.1 - 0.49 / ERROR_SCALE, 0.5);
        assert_eq!(memory.learn(Lesson::Adopt), Lesson::Adopt, "less than half a cmH2O does not surprise");
        let mut memory = after(usize::from(LEARNING), 0.1);
        breathe(&mut memory, 1000, 0.1 + 0.51 / ERROR_SCALE, 0.5);
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
