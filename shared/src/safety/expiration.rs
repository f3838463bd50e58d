//! What the ventilator does in expirations that do not go as they should.
//!
//! * The pressure falls below PEEP (a leak): a bounded flow through the inspiratory valve holds it; much flow is an alarm.
//! * It is still falling when the next breath is due (obstruction, trapped gas): the expiration lasts longer.
//! * It stands constant above PEEP (the PEEP valve is stuck): PIP rises by as much, so that the breaths keep their volume.
//!   Not so unless the flow sensor shows that the gas gets out again.

use super::breath_monitor::ABOVE_PEEP;
use super::monitors::{Monitors, in_a_row, ticks};
use crate::breath::{Breath, Phase, period_s};
use crate::math;
use crate::safety::alarms::Fault;

/// Pressure below PEEP from which the leak is compensated, cmH2O.
const SAG: f32 = 0.5;
/// Rise of the compensation per sag, %/s per cmH2O.
const RISE: f32 = 40.0;
/// Fall of the compensation while the pressure does not sag, %/s.
const RELEASE: f32 = 8.0;
/// Highest command of the compensation, percent.
const BOUND: f32 = 40.0;
/// Compensation above which it tells of a leak, percent.
const LEAK: f32 = 5.0;
/// Share of the inspired volume that comes out of a tight circuit; efforts need compensation too, but their gas comes out.
pub const TIGHT: f32 = 0.75;
/// Share below which the circuit leaks, whatever the compensation: a low PEEP needs none.
const OPEN: f32 = 0.6;
/// Breaths in a row with such a compensation and loss that raise the alarm.
const LEAKS: u32 = 3;
/// Incomplete expirations in a row to which the ventilator responds.
const IN_A_ROW: u32 = 2;
/// Time before the end of the expiration from which a constant pressure has changed little, s.
const CONSTANT_FOR: f32 = 0.5;
/// Largest such change, cmH2O.
const CONSTANT: f32 = 0.5;
/// Share of the inspired volume that must come out before PIP may follow its baseline.
const COMES_OUT: f32 = 0.5;
/// Distance from the pressure limit that PIP keeps when it rises, cmH2O: more than a normal overshoot.
const BELOW_LIMIT: f32 = 7.0;
/// Time constant of the smoothed pressure, s.
const SMOOTHING: f32 = 0.02;

/// Configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expiration {
    /// Whether the monitor of the baseline is enabled.
    enabled: bool,
    period: f32,
    smoothing: f32,
    constant_for: u32,
    /// Expirations after which a leak is an alarm.
    leaks: u32,
}

/// State; all zero before the first breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExpirationState {
    /// Compensation of a leak, percent.
    compensation: f32,
    /// Expirations in a row with a high one.
    leaks: u32,
    /// Smoothed pressure, and what it was [`CONSTANT_FOR`] before the end of the expiration, cmH2O.
    smooth: f32,
    earlier: f32,
    /// Incomplete expirations in a row.
    incomplete: u32,
    /// Whether the last of them was still falling.
    falling: bool,
    /// Constant baseline above PEEP, and the rise of PIP with it, cmH2O.
    above: f32,
    shift: f32,
}

impl Expiration {
    /// For a control period in microseconds; without the monitor of the baseline no expiration is lengthened.
    pub fn new(period_us: u32, enabled: Monitors) -> Self {
        let period = period_s(period_us);
        Self {
            enabled: enabled.has(Fault::BaselineHigh),
            period,
            smoothing: math::lag_factor(SMOOTHING, period),
            constant_for: ticks(CONSTANT_FOR, period_us),
            leaks: enabled.limit(Fault::Leak, LEAKS),
        }
    }

    /// Records the pressure of a tick of a breath, cmH2O. A doubtful pressure raises no flow.
    #[inline]
    pub fn observe(
        &self,
        state: &mut ExpirationState,
        breath: &Breath,
        tick: u32,
        pressure: f32,
        doubtful: bool,
    ) {
        state.smooth += self.smoothing * (pressure - state.smooth);
        if tick + self.constant_for == breath.total_ticks() && breath.phase(tick) == Phase::Expiration {
            state.earlier = state.smooth;
        }
        let sag = breath.settings().peep - SAG - pressure;
        if breath.phase(tick) == Phase::Expiration {
            let rate = if sag > 0.0 && !doubtful { RISE * sag } else { -RELEASE };
            state.compensation = math::limit(state.compensation + rate * self.period, 0.0, BOUND);
        }
        if tick + 1 == breath.total_ticks() {
            self.assess(state, breath.settings().peep);
        }
    }

    /// Assesses an expiration at its end.
    fn assess(&self, state: &mut ExpirationState, peep: f32) {
        let above = state.smooth - peep;
        state.incomplete = in_a_row(state.incomplete, self.enabled && above > ABOVE_PEEP);
        state.falling = state.earlier - state.smooth > CONSTANT;
        state.above = if state.incomplete >= IN_A_ROW && !state.falling { above } else { 0.0 };
    }

    /// Starts a breath after one of which this share of the volume came out, if that was measured: lets PIP follow the
    /// baseline. True if breaths tell of a leak.
    pub fn start_breath(&self, state: &mut ExpirationState, expired_share: Option<f32>) -> bool {
        let comes_out = expired_share.is_some_and(|share| share >= COMES_OUT);
        state.shift = if comes_out { state.above } else { 0.0 };
        let least = if state.compensation > LEAK { TIGHT } else { OPEN };
        state.leaks = in_a_row(state.leaks, expired_share.is_some_and(|share| share < least));
        state.leaks >= self.leaks
    }

    /// Whether the expiration goes on at a tick at which the next breath is due.
    pub fn goes_on(&self, state: &ExpirationState, breath: &Breath, tick: u32) -> bool {
        let peep = breath.settings().peep;
        let incomplete = state.incomplete >= IN_A_ROW && state.smooth - peep > ABOVE_PEEP;
        incomplete && state.falling && tick < breath.total_ticks() + breath.total_ticks() / 2
    }
}

impl ExpirationState {
    /// Command that holds PEEP against a leak, percent.
    pub fn compensation(&self) -> f32 {
        self.compensation
    }

    /// Rise of PIP with a constant baseline, cmH2O.
    pub fn shift(&self, breath: &Breath) -> f32 {
        let settings = breath.settings();
        math::limit(self.shift, 0.0, settings.pressure_limit - BELOW_LIMIT - settings.pip)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};

    fn breath() -> Breath {
        Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap()
    }

    /// Runs breaths with a plateau and a pressure in the expiration by the tick since it began.
    fn breaths(count: usize, plateau: f32, pressure: impl Fn(u32) -> f32) -> (Expiration, ExpirationState) {
        breaths_with(count, plateau, Some(1.0), pressure)
    }

    /// The same, with this share of each breath's volume coming out.
    fn breaths_with(
        count: usize,
        plateau: f32,
        expired_share: Option<f32>,
        pressure: impl Fn(u32) -> f32,
    ) -> (Expiration, ExpirationState) {
        let (expiration, mut state) = (Expiration::new(1000, Monitors::ALL), ExpirationState::default());
        let breath = breath();
        for tick in (0..count).flat_map(|_| 0..breath.total_ticks()) {
            let since = tick.checked_sub(breath.inspiration_ticks());
            expiration.observe(&mut state, &breath, tick, since.map_or(plateau, &pressure), false);
            if tick + 1 == breath.total_ticks() {
                expiration.start_breath(&mut state, expired_share);
            }
        }
        (expiration, state)
    }

    #[test]
    fn a_sag_is_compensated_and_the_compensation_ends_with_it() {
        let (expiration, mut state) = breaths(1, 25.0, |_| 4.0);
        assert!((15.0..35.0).contains(&state.compensation()), "{}", state.compensation());
        let (_, bounded) = breaths(9, 25.0, |_| 0.0);
        assert!((bounded.compensation() - BOUND).abs() < 1e-3);
        let breath = breath();
        for tick in (0..15).flat_map(|_| 1500..3000) {
            expiration.observe(&mut state, &breath, tick, 5.0, false);
        }
        assert!(state.compensation().abs() < 1e-3);
    }

    #[test]
    fn a_sag_that_only_one_of_two_sensors_shows_raises_no_flow() {
        let (expiration, mut state) = breaths(0, 25.0, |_| 0.0);
        let breath = breath();
        for tick in 1500..3000 {
            expiration.observe(&mut state, &breath, tick, 2.0, true);
        }
        assert!(state.compensation().abs() < 1e-3);
    }

    #[test]
    fn a_leak_takes_compensation_and_gas_and_an_effort_compensation_alone() {
        let leaks = |share, pressure: f32| {
            let (expiration, mut state) = breaths_with(4, 25.0, share, |_| pressure);
            state.compensation = state.compensation.max(if pressure < 4.5 { BOUND } else { 0.0 });
            expiration.start_breath(&mut state, share)
        };
        assert!(leaks(Some(0.7), 4.0) && leaks(Some(0.5), 5.0));
        assert!(!leaks(Some(0.9), 4.0) && !leaks(None, 4.0) && !leaks(Some(0.7), 5.0));
        let (expiration, mut state) = breaths_with(1, 25.0, Some(0.5), |_| 4.0);
        assert!(
            !expiration.start_breath(&mut state, Some(0.5)) && expiration.start_breath(&mut state, Some(0.5))
        );
    }

    #[test]
    fn noise_around_peep_is_no_sag() {
        let (_, state) = breaths(10, 25.0, |tick| if tick % 2 == 0 { 4.6 } else { 5.4 });
        assert!(state.compensation().abs() < 1e-3);
    }

    #[test]
    fn an_expiration_that_still_falls_lasts_up_to_half_a_breath_longer() {
        let slowly = |tick: u32| 25.0 - 0.005 * tick as f32;
        let (expiration, state) = breaths(2, 25.0, slowly);
        let breath = breath();
        assert!(expiration.goes_on(&state, &breath, 3000) && expiration.goes_on(&state, &breath, 4499));
        assert!(!expiration.goes_on(&state, &breath, 4500));
        assert!(state.shift(&breath).abs() < 1e-6, "PIP does not rise");
        let (expiration, state) = breaths(1, 25.0, slowly);
        assert!(!expiration.goes_on(&state, &breath, 3000), "after the second one");
        let (mut expiration, state) = breaths(2, 25.0, slowly);
        expiration = Expiration { enabled: false, ..expiration };
        let mut without = ExpirationState { incomplete: 0, ..state };
        expiration.assess(&mut without, 5.0);
        assert!(!expiration.goes_on(&without, &breath, 3000));
    }

    #[test]
    fn pip_follows_a_constant_baseline_up_to_the_limit() {
        let (expiration, state) = breaths(2, 25.0, |_| 15.0);
        assert!((state.shift(&breath()) - 10.0).abs() < 0.1);
        assert!(!expiration.goes_on(&state, &breath(), 3000), "it would not fall any further");
        let tight = crate::settings::Settings { pressure_limit: 36.0, ..paper_settings(25.0) };
        let tight = Breath::new(&tight, DEFAULT_PERIOD_US).unwrap();
        assert!((state.shift(&tight) - 4.0).abs() < 1e-3);
        let (_, back) = breaths(3, 25.0, |_| 5.0);
        assert!(back.shift(&breath()).abs() < 1e-6);
    }

    #[test]
    fn pip_does_not_rise_if_the_gas_does_not_get_out() {
        for share in [Some(0.2), None] {
            let (_, state) = breaths_with(4, 25.0, share, |_| 15.0);
            assert!(state.shift(&breath()).abs() < 1e-6);
        }
    }
}
