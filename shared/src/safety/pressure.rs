//! Is the airway pressure bearable?
//!
//! Above the limit a breath ends at once: inspiratory valve closed, expiratory valve open. That is all for a cough; what
//! comes back breath after breath is the ladder's concern, and what does not fall is latched.

use super::alarms::Fault;
use super::monitors::{Monitors, Times};

/// So far above its limit no pressure is waited for, cmH2O.
pub const FAR_ABOVE: f32 = 15.0;
/// So close to PEEP the pressure counts as back, cmH2O.
const BACK_AT_PEEP: f32 = 3.0;
/// How far ahead the pressure is looked for, ticks of 1 ms: the valve's dead time, in which no command helps.
const AHEAD: f32 = 12.0;
/// How far above the limit it must then be, cmH2O: more than noise and the rise of an open airway make of it.
const AHEAD_ABOVE: f32 = 5.0;
/// Share of a new change in the mean slope.
const SLOPE_SHARE: f32 = 0.2;

/// What the pressures so far say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pressure {
    last: Option<f32>,
    /// Mean change in a tick, cmH2O.
    slope: f32,
    above: u32,
    ahead_above: u32,
    far_above: u32,
    away: u32,
}

/// What to do about the pressure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bearable {
    /// Nothing.
    Yes,
    /// End the inspiration.
    EndBreath,
    /// Vent.
    No(Fault),
}

impl Pressure {
    /// Nothing has been seen yet.
    pub const fn new() -> Self {
        Self { last: None, slope: 0.0, above: 0, ahead_above: 0, far_above: 0, away: 0 }
    }

    /// Takes in a believed pressure, cmH2O; `venting` says that the expiratory valve stands open.
    #[inline]
    pub fn check(
        &mut self,
        pressure: f32,
        limit: f32,
        peep: f32,
        venting: bool,
        monitors: Monitors,
        times: &Times,
    ) -> Bearable {
        let last = self.last.replace(pressure).unwrap_or(pressure);
        self.slope += SLOPE_SHARE * (pressure - last - self.slope);
        let count = |counter: u32, yes: bool| if yes { counter.saturating_add(1) } else { 0 };
        self.above = count(self.above, pressure > limit);
        self.far_above = count(self.far_above, pressure > limit + FAR_ABOVE);
        let ahead = pressure + AHEAD * self.slope;
        self.ahead_above = count(self.ahead_above, times.quick && ahead > limit + AHEAD_ABOVE);
        self.away = count(self.away, pressure > peep + BACK_AT_PEEP);
        let stays = venting && self.above >= times.venting;
        if monitors.has(Fault::HardLimit) && (self.far_above >= times.spike || stays) {
            return Bearable::No(Fault::HardLimit);
        }
        if monitors.has(Fault::SustainedPressure) && self.away >= times.sustained {
            return Bearable::No(Fault::SustainedPressure);
        }
        let ends = self.above >= times.spike || self.ahead_above >= times.spike;
        if monitors.has(Fault::HighPressure) && ends { Bearable::EndBreath } else { Bearable::Yes }
    }
}

impl Default for Pressure {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: f32 = 40.0;

    fn times() -> Times {
        Times::new(1000)
    }

    /// The first thing to do about pressures, and at which of them.
    fn first(pressures: impl IntoIterator<Item = f32>, venting: bool) -> Option<(usize, Bearable)> {
        let mut monitor = Pressure::new();
        pressures
            .into_iter()
            .map(|p| monitor.check(p, LIMIT, 5.0, venting, Monitors::ALL, &times()))
            .enumerate()
            .find(|(_, bearable)| *bearable != Bearable::Yes)
    }

    #[test]
    fn three_milliseconds_above_the_limit_end_the_breath_and_a_spike_does_not() {
        let slow = |n: usize| 30.0 + 0.1 * n as f32;
        assert_eq!(first((0..400).map(slow), false), Some((103, Bearable::EndBreath)));
        let spikes = (0..400).map(|n| if u32::is_multiple_of(n, 10) { 40.5 } else { 39.5 });
        assert_eq!(first((0..200).map(|n| 39.5_f32.min(slow(n))).chain(spikes), false), None);
    }

    #[test]
    fn a_pressure_that_rises_fast_ends_the_breath_before_it_has_crossed_the_limit() {
        let (at, bearable) = first((0..60).map(|n| 5.0 + 1.2 * n as f32), false).unwrap();
        assert_eq!(bearable, Bearable::EndBreath);
        assert!(5.0 + 1.2 * (at as f32) < 36.0, "tick {at}");
    }

    #[test]
    fn far_above_the_limit_or_above_it_with_an_open_valve_is_not_waited_for() {
        let far = (0..100).map(|n| (10.0 + n as f32).min(56.0));
        let vents = |found: Option<(usize, Bearable)>| matches!(found, Some((_, Bearable::No(_))));
        let mut monitor = Pressure::new();
        let last = far.map(|p| monitor.check(p, LIMIT, 5.0, false, Monitors::ALL, &times())).last();
        assert_eq!(last, Some(Bearable::No(Fault::HardLimit)));
        let mut monitor = Pressure::new();
        let stays = |n: usize| (n, if n < 400 { 30.0 + 0.05 * n as f32 } else { 45.0 });
        let found = (0..600)
            .map(stays)
            .map(|(n, p)| (n, monitor.check(p, LIMIT, 5.0, true, Monitors::ALL, &times())))
            .find(|(_, bearable)| matches!(bearable, Bearable::No(_)));
        assert!(vents(found) && (340..360).contains(&found.unwrap().0), "{found:?}");
    }

    #[test]
    fn a_pressure_that_never_comes_down_is_found_after_a_quarter_of_a_minute() {
        let breathing = (0..60_000).map(|n| if n % 3000 < 1000 { 25.0 } else { 5.2 });
        let mut monitor = Pressure::new();
        let mut slow = 5.0;
        for target in breathing {
            slow += 0.01 * (target - slow);
            assert_eq!(monitor.check(slow, LIMIT, 5.0, false, Monitors::ALL, &times()), Bearable::Yes);
        }
        let stuck = first((0..16_000).map(|_| 12.0), false);
        assert_eq!(stuck, Some((14_999, Bearable::No(Fault::SustainedPressure))));
    }
}
