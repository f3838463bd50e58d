//! The loss of a breath: mean distance of the pressure from its target, with a factor on overshoot.

use engine::{Lane, huber};
use shared::control::COMMAND_MAX;

use super::scenario::Scenario;

/// Error below which the L1 loss is smoothed, cmH2O: its kink would make the last training steps oscillate.
const ROUNDING: f32 = 0.02;

/// Loss of a shard: the weighted mean of |p - target| over ticks and rollouts (with its factor on overshoot), and the
/// unweighted mean of each rollout.
#[derive(Clone, Debug)]
pub struct Loss {
    /// Weighted sum over rollouts of the mean over ticks.
    pub weighted: f64,
    /// Mean |p - target| of each rollout, cmH2O.
    pub score: Lane,
}

impl Loss {
    /// The loss from the pressures (cmH2O) of all ticks.
    pub fn of(scenario: &Scenario, pressure: &[Lane]) -> Self {
        let (mut score, mut weighted) = (Lane::ZERO, 0.0);
        let share = 1.0 / scenario.ticks as f32;
        for (tick, pressure) in pressure[..scenario.ticks].iter().enumerate().skip(scenario.scored_from) {
            let error = pressure.zip(scenario.prescribed.target(tick), |p, target| p - target);
            score.add_scaled(share, &error.map(f32::abs));
            let above = scenario.overshoot_weight - 1.0;
            let rounded = error.zip(&scenario.overshoot_from, |e, from| {
                huber::value(e, ROUNDING) + above * huber::value((e - from).max(0.0), ROUNDING)
            });
            weighted += f64::from(rounded.zip(&scenario.weight, |e, w| share * w * e).sum());
        }
        Self { weighted, score }
    }

    /// Mean score of the rollouts, cmH2O.
    pub fn mean_score(&self) -> f64 {
        f64::from(self.score.sum()) / engine::LANES as f64
    }
}

/// Gradient of [`Loss::weighted`] with respect to the pressures of a tick.
pub(super) fn slope(scenario: &Scenario, pressure: &Lane, tick: usize) -> Lane {
    if tick < scenario.scored_from {
        return Lane::ZERO;
    }
    let (above, target) = (scenario.overshoot_weight - 1.0, scenario.prescribed.target(tick));
    let share = 1.0 / scenario.ticks as f32;
    Lane::from_fn(|l| {
        let error = pressure[l] - target[l];
        let slope = huber::slope(error, ROUNDING);
        let overshoot = huber::slope((error - scenario.overshoot_from[l]).max(0.0), ROUNDING);
        share * scenario.weight[l] * (slope + above * overshoot)
    })
}

/// Change of the command in a tick below which its price is smoothed, percent.
const EFFORT_ROUNDING: f32 = 0.2;

/// Gradient of the price of moving the valve with respect to the command of one tick.
pub(super) fn effort_slope(scenario: &Scenario, commands: &[Lane], tick: usize) -> Lane {
    let first = scenario.settled.iter().min().copied().unwrap_or(scenario.ticks);
    if scenario.effort_price <= 0.0 || tick < first {
        return Lane::ZERO;
    }
    let step =
        |from: usize| commands[from].zip(&commands[from + 1], |a, b| huber::slope(b - a, EFFORT_ROUNDING));
    let before = if tick > first { step(tick - 1) } else { Lane::ZERO };
    let after = if tick + 1 < scenario.ticks { step(tick) } else { Lane::ZERO };
    Lane::from_fn(|l| {
        let first = scenario.settled[l];
        let (before, after) =
            (if tick > first { before[l] } else { 0.0 }, if tick >= first { after[l] } else { 0.0 });
        let share = scenario.effort_price / (scenario.ticks - first).max(1) as f32;
        share * scenario.weight[l] * (before - after)
    })
}

/// Distance below the target from which a loop is still far from it, cmH2O: more than any valve's lag can leave of a pressure that rises
/// this late.
const FAR: f32 = 4.0;

/// Gradient of the price of holding the valve back although the pressure is far below its target, long after it should have reached
/// it, with respect to the command of one tick. Only the open valve helps there, and the distance itself says little of it: on a unit
/// that cannot reach its target it hardly depends on the last percents.
pub(super) fn restraint_slope(scenario: &Scenario, pressure: &Lane, command: &Lane, tick: usize) -> Lane {
    if scenario.restraint_price <= 0.0 {
        return Lane::ZERO;
    }
    let below = scenario.prescribed.target(tick).zip(pressure, |target, p| target - p);
    let share = scenario.restraint_price / scenario.ticks as f32;
    Lane::from_fn(|l| {
        let restrained = below[l] > FAR && tick >= scenario.settled[l] && command[l] < COMMAND_MAX;
        if restrained { -share } else { 0.0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_before_the_scored_ticks_counts_nothing() {
        let scenario = Scenario { scored_from: 1, ..Scenario::plain(2, Lane::splat(20.0)) };
        let (low, on_target) = (Lane::splat(10.0), Lane::splat(20.0));
        assert!(Loss::of(&scenario, &[low, on_target]).weighted.abs() < 1e-9);
        assert!(Loss::of(&scenario, &[on_target, low]).weighted > 1.0);
        assert!(slope(&scenario, &low, 0).sum().abs() < 1e-9 && slope(&scenario, &low, 1).sum() < -1.0);
    }

    #[test]
    fn only_a_valve_that_is_held_back_far_below_a_late_target_is_urged_to_open() {
        let plain = Scenario::plain(4, Lane::splat(20.0));
        let scenario = Scenario { settled: [2; engine::LANES], restraint_price: 0.4, ..plain };
        let (far, near) = (Lane::splat(20.0 - 1.01 * FAR), Lane::splat(20.0 - 0.99 * FAR));
        let (held, open) = (Lane::splat(99.0), Lane::splat(100.0));
        let at = |pressure, command, tick| restraint_slope(&scenario, pressure, command, tick)[0];
        assert!((at(&far, &held, 2) + 0.1).abs() < 1e-6);
        for (pressure, command, tick) in [(&near, &held, 2), (&far, &open, 2), (&far, &held, 1)] {
            assert!(at(pressure, command, tick).abs() < 1e-9, "tick {tick}");
        }
    }

    #[test]
    fn the_price_of_moving_the_valve_agrees_with_finite_differences() {
        const TICKS: usize = 6;
        let settled = std::array::from_fn(|l| 1 + l % 4);
        let scenario = Scenario { settled, effort_price: 0.02, ..Scenario::plain(TICKS, Lane::splat(20.0)) };
        let commands: Vec<Lane> = (0..TICKS)
            .map(|tick| Lane::from_fn(|l| 20.0 + ((7 * tick * tick + 3 * l) % 11) as f32 * 0.1))
            .collect();
        let price = |commands: &[Lane], l: usize| {
            let steps = settled[l]..TICKS - 1;
            let value: f64 = steps
                .map(|t| f64::from(huber::value(commands[t + 1][l] - commands[t][l], EFFORT_ROUNDING)))
                .sum();
            0.02 * value / (TICKS - settled[l]) as f64
        };
        let step = 0.01;
        for tick in 0..TICKS {
            let slope = effort_slope(&scenario, &commands, tick);
            for l in 0..engine::LANES {
                let at = |step: f32| {
                    let mut moved = commands.clone();
                    moved[tick][l] += step;
                    price(&moved, l)
                };
                let numeric = (at(step) - at(-step)) / f64::from(2.0 * step);
                assert!((numeric - f64::from(slope[l])).abs() < 2e-4, "tick {tick}, rollout {l}: {numeric}");
            }
        }
    }

    #[test]
    fn the_slope_agrees_with_finite_differences_and_overshoot_weighs_more() {
        let scenario = Scenario {
            weight: Lane::from_fn(|l| if l % 3 == 0 { 1.0 } else { 0.5 }),
            overshoot_weight: 1.5,
            overshoot_from: Lane::splat(1.75),
            ..Scenario::plain(2, Lane::splat(20.0))
        };
        // Errors from -7.5 to 7.5; none is at the kink.
        let pressure = Lane::from_fn(|l| 12.5 + l as f32);
        let slope = slope(&scenario, &pressure, 0);
        let step = 0.25;
        for l in 0..engine::LANES {
            let at = |step: f32| {
                let mut moved = pressure;
                moved[l] += step;
                Loss::of(&scenario, &[pressure, moved]).weighted
            };
            let numeric = (at(step) - at(-step)) / f64::from(2.0 * step);
            assert!((numeric - f64::from(slope[l])).abs() < 1e-4, "rollout {l}: {numeric}");
        }
        assert!((slope[15] + 1.5 * slope[0]).abs() < 1e-6);
    }
}
