//! How a simulator divides time: control ticks into blocks; blocks into parts, over which commands are averaged, and
//! points, at which pressures are given.

use serde::{Deserialize, Serialize};

use super::shape::{ShapeError, within};

/// How a simulator divides time, in control ticks of the recording that it was fitted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Control period, microseconds.
    pub period_us: u32,
    /// Number of control ticks per block.
    pub block_ticks: usize,
    /// Number of parts of a block over which commands are averaged.
    pub parts: usize,
    /// Number of pressure points per block; the last one is at its end.
    pub points: usize,
    /// Number of command channels: 1 for only the inspiratory valve.
    pub channels: usize,
}

/// Longest block, seconds: the shortest dead time of the bench's valve.
const BLOCK_TIME: f32 = 0.010;
/// Largest number of control ticks per block that a file may have: a block at a period of 1 us.
const BLOCK_TICKS_MAX: usize = 10_000;
/// Largest number of command channels: both valves, and exploration.
const CHANNELS_MAX: usize = 3;
/// Longest control period that a file may have, microseconds.
const PERIOD_MAX_US: usize = 1_000_000;

impl Timing {
    /// The timing for a control period: blocks of 10 ms, or of one tick if that is longer.
    pub fn for_period(period_us: u32, channels: usize) -> Self {
        let block_ticks = (shared::math::ticks(BLOCK_TIME, period_us) as usize).max(1);
        let (parts, points) = if block_ticks >= 2 { (2, 2) } else { (1, 1) };
        Self { period_us, block_ticks, parts, points, channels }
    }

    /// Checks the division of time of a simulator's file.
    ///
    /// # Errors
    /// A value out of bounds.
    pub(super) fn check(&self) -> Result<(), ShapeError> {
        let Self { period_us, block_ticks, parts, points, channels } = *self;
        within("period_us", period_us as usize, 1, PERIOD_MAX_US)?;
        within("block_ticks", block_ticks, 1, BLOCK_TICKS_MAX)?;
        // Each part has a tick.
        within("parts", parts, 1, block_ticks)?;
        within("points", points, 1, 2)?;
        within("channels", channels, 1, CHANNELS_MAX)
    }

    /// Checks that each block is one control tick of one command, as in simulators that advance tick by tick.
    ///
    /// # Errors
    /// A value that is not 1.
    pub(super) fn check_single_ticks(&self) -> Result<(), ShapeError> {
        let Self { block_ticks, parts, points, channels, .. } = *self;
        let ones =
            [("block_ticks", block_ticks), ("parts", parts), ("points", points), ("channels", channels)];
        ones.into_iter().try_for_each(|(name, value)| within(name, value, 1, 1))
    }

    /// Duration of a block, s.
    pub fn block_s(&self) -> f32 {
        self.block_ticks as f32 * self.period_us as f32 * 1e-6
    }

    /// Number of values per block in a [`CommandLog`](super::CommandLog).
    pub fn width(&self) -> usize {
        self.parts * self.channels
    }

    /// Number of blocks that cover `ticks` control ticks.
    pub fn blocks(&self, ticks: usize) -> usize {
        ticks.div_ceil(self.block_ticks)
    }

    /// Age in blocks of the newest command that a step may use: that of the running block if it is a single tick (its
    /// command is known before its pressure), else of the previous block.
    pub fn lag(&self) -> usize {
        usize::from(self.block_ticks > 1)
    }

    /// The part of its block that contains a tick.
    pub fn part(&self, tick_in_block: usize) -> usize {
        tick_in_block * self.parts / self.block_ticks
    }

    /// Number of ticks in a part.
    pub fn part_ticks(&self, part: usize) -> usize {
        (0..self.block_ticks).filter(|tick| self.part(*tick) == part).count()
    }

    /// Weights of the block's start and its points in the pressure `tick` ticks after the start of the block, by
    /// interpolation with a parabola (two points) or a line (one point).
    pub fn interpolation(&self, tick: usize) -> [f32; 3] {
        let s = tick as f32 / self.block_ticks as f32;
        if self.points == 1 {
            return [1.0 - s, s, 0.0];
        }
        [(1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_ten_milliseconds_or_one_tick() {
        let fast = Timing::for_period(1000, 1);
        assert_eq!((fast.block_ticks, fast.parts, fast.points, fast.lag()), (10, 2, 2, 1));
        let slow = Timing::for_period(30_000, 1);
        assert_eq!((slow.block_ticks, slow.parts, slow.points, slow.lag()), (1, 1, 1, 0));
        assert_eq!((fast.blocks(1000), fast.part(4), fast.part(5), fast.part_ticks(0)), (100, 0, 1, 5));
    }

    #[test]
    fn interpolation_passes_through_the_points_and_is_exact_for_parabolas() {
        let timing = Timing::for_period(1000, 1);
        let parabola = |s: f32| 3.0 - 2.0 * s + 5.0 * s * s;
        for tick in 0..=10 {
            let [start, middle, end] = timing.interpolation(tick);
            let value = start * parabola(0.0) + middle * parabola(0.5) + end * parabola(1.0);
            assert!((value - parabola(tick as f32 / 10.0)).abs() < 1e-5);
        }
    }
}
