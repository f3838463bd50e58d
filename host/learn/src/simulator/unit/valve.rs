//! The inspiratory valve of a unit: from commands to the share of its full flow.
//!
//! ```text
//! u_d  = command a dead time ago, between two ticks        a' = a + (u_d - a)(1 - exp(-tick / lag))
//! s'   = s held within [a', a' + min(play, a')]            w  = max((s' - zone) / (100 - zone), 0) ^ exponent
//! ```
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use engine::number::Number;

use super::{MS_PER_S, left_after};

pub(super) const DEAD_TIME: usize = 0;
pub(super) const LAG: usize = 1;
pub(super) const PLAY: usize = 2;
pub(super) const ZONE: usize = 3;
pub(super) const EXPONENT: usize = 4;
pub(super) const FULL_FLOW: usize = 5;
/// Number of [`numbers`], and of pieces of state.
pub(super) const NUMBERS: usize = 5;
pub(super) const STATE: usize = 2;
/// Highest command, percent.
const FULL: f32 = 100.0;
/// Travel beyond the dead zone, as a share, below which nothing flows.
const LEAST: f32 = 1e-4;

/// A dead time in ticks.
pub(super) fn ticks<Q: Number>(dead_time: Q, tick_s: f32) -> Q {
    dead_time / dead_time.constant(MS_PER_S * tick_s)
}

/// The part of the dead time beyond whole ticks; the share of the remaining way that the actuator moves in a
/// tick; play, dead zone, exponent.
pub(super) fn numbers<Q: Number>(
    [dead_time, lag, play, zone, exponent]: [Q; 5],
    tick_s: f32,
) -> [Q; NUMBERS] {
    let ticks = ticks(dead_time, tick_s);
    let share = lag.constant(1.0) - left_after(lag, tick_s);
    [ticks - ticks.floor(), share, play, zone, exponent]
}

/// Actuator and stem after a tick, percent, and the share of the full flow. Nothing moves a stem that rests
/// within the play behind the actuator; near the seat, where the actuator's position is less than the play,
/// the play is that position.
#[inline(always)]
pub(super) fn tick<Q: Number>(
    [part, share, play, zone, exponent]: [Q; NUMBERS],
    [actuator, stem]: [Q; STATE],
    [newer, older]: [Q; 2],
) -> ([Q; STATE], Q) {
    let delayed = newer + part * (older - newer);
    let actuator = actuator + share * (delayed - actuator);
    let stem = held(stem, actuator, play);
    ([actuator, stem], opening(stem, zone, exponent))
}

/// A stem behind an actuator, percent: pushed by it, and drawn back only when the play is taken up.
#[inline]
pub(super) fn held<Q: Number>(stem: Q, actuator: Q, play: Q) -> Q {
    stem.min(actuator + play.min(actuator)).max(actuator)
}

/// Share of the full flow at a position of the stem, percent.
#[inline(always)]
pub(super) fn opening<Q: Number>(stem: Q, zone: Q, exponent: Q) -> Q {
    let travel = (stem - zone) / (zone.constant(FULL) - zone);
    let least = zone.constant(LEAST);
    travel.max(least).pow(exponent).where_greater(travel, least)
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::Lane;

    #[test]
    fn a_stem_stays_within_the_play_before_its_actuator() {
        let at =
            |stem: f32, actuator: f32| held(Lane::splat(stem), Lane::splat(actuator), Lane::splat(4.0))[0];
        for (stem, actuator, wanted) in
            [(30.0, 5.0, 9.0), (7.0, 5.0, 7.0), (3.0, 15.0, 15.0), (30.0, 1.0, 2.0), (30.0, 0.0, 0.0)]
        {
            assert!((at(stem, actuator) - wanted).abs() < 1e-6, "{stem} behind {actuator}");
        }
    }
}
