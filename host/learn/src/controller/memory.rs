//! What the breaths of a shard remember of earlier ones: [`shared::control::memory`] over lanes.
//!
//! Training takes what is remembered as given: it learns to make the best of it, not to prepare the next breath.

use engine::{LANES, Lane};
use shared::control::features::{COMMAND_SCALE, ERROR_SCALE};
use shared::control::memory::{
    BINS, BreathMemory, COMMANDS_AHEAD, ERRORS_AHEAD, Lesson, Place, RECALLED, bin_ticks, since_first,
};

use super::signals::Signals;

/// The memories of a shard.
#[derive(Clone, Debug)]
pub struct LaneMemory {
    bin_ticks: u32,
    lanes: Vec<BreathMemory>,
}

/// What the breaths of a shard recall: error and command of every bin, and whether there is anything to recall.
#[derive(Clone, Debug)]
pub struct Recall {
    bin_ticks: u32,
    bins: Vec<[Lane; 2]>,
    any: Lane,
    /// What an oracle says in its place, and from which tick on.
    told: Option<([Lane; RECALLED], usize)>,
    /// Whether a student's state takes its place.
    is_student: bool,
}

impl LaneMemory {
    /// Nothing remembered.
    pub fn new(period_us: u32) -> Self {
        Self { bin_ticks: bin_ticks(period_us), lanes: vec![BreathMemory::new(); LANES] }
    }

    /// Forgets all of one lane.
    pub fn forget(&mut self, lane: usize) {
        self.lanes[lane] = BreathMemory::new();
    }

    /// What the next breaths recall.
    pub(super) fn recall(&self) -> Recall {
        let of = |bin: usize, signal: usize| Lane::from_fn(|l| self.lanes[l].remembered(bin)[signal]);
        Recall {
            bin_ticks: self.bin_ticks,
            bins: (0..BINS).map(|bin| [of(bin, 0), of(bin, 1)]).collect(),
            any: Lane::from_fn(|l| f32::from(u8::from(self.lanes[l].adopted() > 0))),
            told: None,
            is_student: false,
        }
    }

    /// Learns from a breath of this many ticks with these signals, except in lanes that are to be left out.
    pub(super) fn adopt(&mut self, signals: &Signals, ticks: usize, left_out: impl Fn(usize) -> bool) {
        for (l, memory) in self.lanes.iter_mut().enumerate() {
            if left_out(l) {
                continue;
            }
            for (error, command) in signals.error[..ticks].iter().zip(&signals.command) {
                memory.record(self.bin_ticks, error[l] / ERROR_SCALE, command[l] / COMMAND_SCALE);
            }
            memory.learn(Lesson::Adopt);
        }
    }
}

impl Recall {
    /// What an oracle says, nothing before a tick and the same from then on.
    pub(super) fn told(numbers: &[Lane; RECALLED], from: usize) -> Self {
        Self {
            bin_ticks: 1,
            bins: Vec::new(),
            any: Lane::ZERO,
            told: Some((*numbers, from)),
            is_student: false,
        }
    }

    /// The place of a student's state, in a breath that recalls nothing.
    pub(super) fn of_student() -> Self {
        Self { is_student: true, ..Self::told(&[Lane::ZERO; RECALLED], 0) }
    }

    /// Whether a student's state takes its place.
    pub(super) fn is_student(&self) -> bool {
        self.is_student
    }

    /// Writes what every lane recalls at a tick.
    pub(super) fn at(&self, tick: usize, out: &mut [Lane]) {
        if let Some((numbers, from)) = &self.told {
            out.copy_from_slice(if tick < *from { &[Lane::ZERO; RECALLED] } else { numbers });
            return;
        }
        let now = since_first(tick as u32, self.bin_ticks);
        let seen = |signal: usize, ahead: usize| {
            let Place { bin, share } = Place::at(now + ahead as f32);
            let entry = |bin: usize| &self.bins[bin.min(BINS - 1)][signal];
            entry(bin).zip(entry(bin + 1), |first, second| first + share * (second - first))
        };
        let errors = ERRORS_AHEAD.map(|ahead| seen(0, ahead));
        let commands = COMMANDS_AHEAD.map(|ahead| seen(1, ahead));
        out[..RECALLED - 1].copy_from_slice(&[&errors[..], &commands].concat());
        out[RECALLED - 1] = self.any;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_and_chip_recall_the_same_bits() {
        let mut memory = LaneMemory::new(1000);
        let mut signals = Signals::new(1700);
        for (tick, (error, command)) in signals.error.iter_mut().zip(&mut signals.command).enumerate() {
            *error = Lane::from_fn(|l| (0.01 * (tick * (l + 1)) as f32).sin());
            *command = Lane::from_fn(|l| 40.0 + (0.02 * (tick * (l + 1)) as f32).cos());
        }
        for ticks in [1700, 900] {
            memory.adopt(&signals, ticks, |l| l == 3);
            let recall = memory.recall();
            let mut out = [Lane::ZERO; RECALLED];
            for tick in [0, 3, 100, 511, 515, 1023, 1400, 5000] {
                recall.at(tick, &mut out);
                for l in [0, 3, LANES - 1] {
                    let chip = memory.lanes[l].recall(tick as u32, memory.bin_ticks);
                    assert_eq!(chip.map(f32::to_bits), out.map(|lane| lane[l].to_bits()), "tick {tick}");
                }
                assert_eq!(
                    [out[RECALLED - 1][0].to_bits(), out[RECALLED - 1][3].to_bits()],
                    [1.0_f32.to_bits(), 0]
                );
            }
        }
    }
}
