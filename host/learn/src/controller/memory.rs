//! What the breaths of a shard remember of earlier ones: [`shared::control::memory`] over lanes.
//!
//! Training takes what is remembered as given: it learns to make the best of it, not to prepare the next breath.

use engine::{LANES, Lane};
use shared::control::features::{COMMAND_SCALE, ERROR_SCALE};
use shared::control::memory::{BreathMemory, Lesson, RECALLED, bin_ticks};

use super::signals::Signals;

/// The memories of a shard.
#[derive(Clone, Debug)]
pub struct LaneMemory {
    bin_ticks: u32,
    lanes: Vec<BreathMemory>,
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

    /// Writes what every lane recalls at a tick.
    pub(super) fn recall(&self, tick: usize, out: &mut [Lane]) {
        for (l, memory) in self.lanes.iter().enumerate() {
            let recalled: [f32; RECALLED] = memory.recall(tick as u32, self.bin_ticks);
            for (out, value) in out.iter_mut().zip(recalled) {
                out[l] = value;
            }
        }
    }

    /// Learns from a breath with these signals.
    pub(super) fn adopt(&mut self, signals: &Signals) {
        for (l, memory) in self.lanes.iter_mut().enumerate() {
            for (error, command) in signals.error.iter().zip(&signals.command) {
                memory.record(self.bin_ticks, error[l] / ERROR_SCALE, command[l] / COMMAND_SCALE);
            }
            memory.learn(Lesson::Adopt);
        }
    }
}
