//! Limits how fast the learned part of a command changes, so that no hand-over between controllers is a larger step.

use crate::breath::period_s;
use crate::control::ControlOutput;
use crate::math;

/// Fastest change of the learned part of a command, percent per second: the whole range takes 4 ms. Fulfils: residual-slew.
pub const RESIDUAL_SLEW: f32 = 25_000.0;

/// The limit, built for a control period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slew {
    per_tick: f32,
}

impl Slew {
    /// The limit for a control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        Self { per_tick: RESIDUAL_SLEW * period_s(period_us) }
    }

    /// Largest change in a tick, percent.
    pub fn per_tick(&self) -> f32 {
        self.per_tick
    }

    /// The command with as much of its learned part as the limit allows, percent, and whether that is all of it. `learned` is the
    /// part that was applied in the last tick, percent; one that is not `trusted` fades out.
    #[inline]
    pub fn step(&self, learned: &mut f32, output: ControlOutput, trusted: bool) -> (f32, bool) {
        let wanted = if trusted { output.command - output.base } else { 0.0 };
        let change = wanted - *learned;
        if trusted && change.abs() <= self.per_tick {
            *learned = wanted;
            return (output.command, true);
        }
        *learned += math::limit(change, -self.per_tick, self.per_tick);
        debug_assert!(learned.is_finite(), "it moves in steps, whatever a controller computes");
        (output.base + *learned, false)
    }
}
