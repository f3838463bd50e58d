//! Learned simulators: differentiable models that predict the next pressures from past commands.
//!
//! A simulator goes forward in *blocks* of control ticks. In a block it gives the pressure at a few *points*
//! (the block's middle and end, or its end alone); pressures in between are interpolated. Commands reach it as
//! means over the *parts* of past blocks, kept in a [`CommandLog`]. Blocks of 10 ms hide within the dead time
//! of valve and tube: what is commanded in a block cannot be felt before the next one, so one network step
//! serves ten control ticks.
//!
//! [`state_space`] and [`hybrid`] are ours, one for one plant, one for many lungs whose nominal R and C are known;
//! [`stitched`] is the architecture of Suo et al. 2021. All implement [`Dynamics`], which is all that training (of
//! either simulator or controller) needs.

pub mod episode;
mod first_order;
pub mod fit;
pub mod hybrid;
mod leaky;
pub mod model;
pub mod state_space;
mod states;
pub mod stitched;
#[cfg(test)]
mod tests_support;

pub use first_order::first_order;

use serde::{Deserialize, Serialize};

use data::identity::LungParameters;
use engine::{LANES, Lane};

/// Pressure that counts as zero, and the distance that counts as one, inside of a simulator, cmH2O.
pub const PRESSURE_SCALE: (f32, f32) = (20.0, 10.0);
/// Pressure before a breath that counts as zero, cmH2O.
const USUAL_PEEP: f32 = 5.0;
/// Command that counts as one inside of a simulator, percent.
pub const COMMAND_SCALE: f32 = 50.0;

/// How a simulator cuts time; in control ticks of the recording it was fitted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Control period, microseconds.
    pub period_us: u32,
    /// Control ticks per block.
    pub block_ticks: usize,
    /// Parts of a block over which commands are averaged.
    pub parts: usize,
    /// Pressure points per block, the last one at its end.
    pub points: usize,
    /// Command channels: 1 for the inspiratory valve alone.
    pub channels: usize,
}

/// Longest block, seconds: the least dead time of the bench's valve.
const BLOCK_TIME: f32 = 0.010;

impl Timing {
    /// The blocks for a control period: 10 ms, or one tick where that is longer.
    pub fn for_period(period_us: u32, channels: usize) -> Self {
        let block_ticks = (shared::math::ticks(BLOCK_TIME, period_us) as usize).max(1);
        let (parts, points) = if block_ticks >= 2 { (2, 2) } else { (1, 1) };
        Self { period_us, block_ticks, parts, points, channels }
    }

    /// Duration of a block, s.
    pub fn block_s(&self) -> f32 {
        self.block_ticks as f32 * self.period_us as f32 * 1e-6
    }

    /// Values per block in a [`CommandLog`].
    pub fn width(&self) -> usize {
        self.parts * self.channels
    }

    /// Blocks that cover `ticks` control ticks.
    pub fn blocks(&self, ticks: usize) -> usize {
        ticks.div_ceil(self.block_ticks)
    }

    /// Age in blocks of the newest command that a step may use: the running block's where it is a single tick
    /// (its command is known before its pressure), the previous one's otherwise.
    pub fn lag(&self) -> usize {
        usize::from(self.block_ticks > 1)
    }

    /// Part of its block in which a tick lies.
    pub fn part(&self, tick_in_block: usize) -> usize {
        tick_in_block * self.parts / self.block_ticks
    }

    /// Number of ticks in a part.
    pub fn part_ticks(&self, part: usize) -> usize {
        (0..self.block_ticks).filter(|tick| self.part(*tick) == part).count()
    }

    /// Weights of the block's start, and its points, in the pressure `tick` ticks after the start of the block:
    /// the parabola (with two points) or line (with one) through them.
    pub fn interpolation(&self, tick: usize) -> [f32; 3] {
        let s = tick as f32 / self.block_ticks as f32;
        if self.points == 1 {
            return [1.0 - s, s, 0.0];
        }
        [(1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)]
    }
}

/// Scaled commands of a shard, averaged over the parts of each block; before the breath they are at rest.
#[derive(Clone, Debug)]
pub struct CommandLog {
    width: usize,
    rest: Vec<Lane>,
    values: Vec<Lane>,
}

impl CommandLog {
    /// An empty log of `blocks` blocks; `rest` holds the values before the breath, one per place of a block.
    pub fn new(blocks: usize, rest: Vec<Lane>) -> Self {
        let width = rest.len();
        Self { width, rest, values: vec![Lane::ZERO; blocks * width] }
    }

    /// Values of a block; those at rest for blocks before the breath.
    pub fn block(&self, block: Option<usize>) -> &[Lane] {
        match block {
            Some(block) => &self.values[block * self.width..(block + 1) * self.width],
            None => &self.rest,
        }
    }

    /// Values of a block, to be written.
    pub fn block_mut(&mut self, block: usize) -> &mut [Lane] {
        &mut self.values[block * self.width..(block + 1) * self.width]
    }

    /// Sets all values to zero.
    pub fn clear(&mut self) {
        self.values.fill(Lane::ZERO);
    }

    /// Copies the newest `history` blocks before and including `newest` into `out`, newest first.
    pub(crate) fn gather(&self, newest: Option<usize>, history: usize, out: &mut [Lane]) {
        for (age, out) in out.chunks_exact_mut(self.width).take(history).enumerate() {
            out.copy_from_slice(self.block(newest.and_then(|block| block.checked_sub(age))));
        }
    }

    /// The reverse of [`Self::gather`] for gradients: adds `d` to the blocks it came from.
    pub(crate) fn scatter(&mut self, newest: Option<usize>, d: &[Lane]) {
        for (age, d) in d.chunks_exact(self.width).enumerate() {
            let Some(block) = newest.and_then(|block| block.checked_sub(age)) else {
                continue;
            };
            for (value, d) in self.block_mut(block).iter_mut().zip(d) {
                value.add_scaled(1.0, d);
            }
        }
    }
}

/// The lung where nothing is known of it: the middle of the paper's.
pub const USUAL_LUNG: LungParameters = LungParameters { resistance: 20.0, compliance: 20.0 };

/// Which member of a family (test runs, ventilators) each lane is of; none for one that no simulator knows.
pub type Members = [Option<u32>; LANES];

/// What a simulator is told of the state in which a breath starts, and of the lung that it is for.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// Pressure just before the breath, cmH2O.
    pub pressure: Lane,
    /// Pressure at the end of the last inspiration, cmH2O: what may still be in the lung.
    pub plateau: Lane,
    /// Scaled command of the inspiratory valve just before the breath; only [`hybrid`] looks at it.
    pub rest: Lane,
    /// The same at the end of the last inspiration.
    pub plateau_command: Lane,
    /// Group (test run) of the recording that a breath is of.
    pub group: Members,
    /// Ventilator of the recording that a breath is of.
    pub ventilator: Members,
    /// Nominal resistance of the lung, cmH2O/(L/s); only [`hybrid`] looks at it.
    pub resistance: Lane,
    /// Nominal compliance of the lung, mL/cmH2O; only [`hybrid`] looks at it.
    pub compliance: Lane,
}

impl Default for Start {
    fn default() -> Self {
        let LungParameters { resistance, compliance } = USUAL_LUNG;
        Self {
            pressure: Lane::ZERO,
            plateau: Lane::ZERO,
            rest: Lane::ZERO,
            group: [None; LANES],
            ventilator: [None; LANES],
            plateau_command: Lane::ZERO,
            resistance: Lane::splat(resistance),
            compliance: Lane::splat(compliance),
        }
    }
}

impl Start {
    /// Number of quantities in [`Self::known`].
    pub(crate) const KNOWN: usize = 4;

    /// What pressures and commands before the breath were, scaled for a network.
    pub(crate) fn known(&self) -> [Lane; Self::KNOWN] {
        let (mean, scale) = PRESSURE_SCALE;
        [
            self.pressure.map(|p| (p - USUAL_PEEP) / scale),
            self.plateau.map(|p| (p - mean) / scale),
            self.rest,
            self.plateau_command,
        ]
    }
}

/// The `n`-th piece of `width` lanes.
fn piece(lanes: &[Lane], n: usize, width: usize) -> &[Lane] {
    &lanes[n * width..(n + 1) * width]
}

fn piece_mut(lanes: &mut [Lane], n: usize, width: usize) -> &mut [Lane] {
    &mut lanes[n * width..(n + 1) * width]
}

/// A differentiable simulator of one shard.
pub trait Dynamics: Sync {
    /// What the forward pass leaves behind for the backward pass.
    type Tape: Send;

    /// How time is cut.
    fn timing(&self) -> &Timing;

    /// Number of parameters.
    fn parameters(&self) -> usize;

    /// Memory for a rollout of so many blocks.
    fn tape(&self, blocks: usize) -> Self::Tape;

    /// Starts a breath.
    fn begin(&self, tape: &mut Self::Tape, start: &Start);

    /// Predicts the pressure at the points of a block, cmH2O.
    fn step(&self, tape: &mut Self::Tape, block: usize, log: &CommandLog, points: &mut [Lane]);

    /// The gradient of what [`Self::step`] did, blocks in reverse order: takes the gradient by the points, adds
    /// the gradient by the commands.
    fn step_back(&self, tape: &mut Self::Tape, block: usize, d_points: &[Lane], d_log: &mut CommandLog);

    /// Adds the gradient by the parameters of the whole rollout, after the last step back.
    fn finish(&self, tape: &mut Self::Tape, gradient: &mut [f32]);
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

    #[test]
    fn a_log_is_at_rest_before_the_breath() {
        let mut log = CommandLog::new(3, vec![Lane::splat(0.1), Lane::splat(0.2)]);
        log.block_mut(0).fill(Lane::splat(7.0));
        let mut seen = vec![Lane::ZERO; 4];
        log.gather(Some(0), 2, &mut seen);
        assert_eq!(
            [seen[0][0], seen[1][0], seen[2][0], seen[3][0]].map(|x| (x * 10.0) as i32),
            [70, 70, 1, 2]
        );
    }
}
