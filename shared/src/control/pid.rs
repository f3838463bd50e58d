//! PID (proportional-integral-derivative) control of the inspiratory valve: parallel form, derivative of the filtered
//! measurement, anti-windup by conditional integration.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{COMMAND_MAX, ControlOutput, Observation};
use crate::breath::period_s;
use crate::math;

/// Time constant of the derivative's filter, s: many ticks to average noise, but shorter than the valve's lag.
pub const DERIVATIVE_LAG: f32 = 0.01;

/// Gains in physical units, as tuned and stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PidGains {
    /// Proportional gain, percent per cmH2O.
    pub p: f32,
    /// Integral gain, percent per cmH2O and second.
    pub i: f32,
    /// Derivative gain, percent per cmH2O/s.
    pub d: f32,
}

/// Largest accepted gains: far above any stable gain, but small enough that nothing overflows.
pub const GAINS_MAX: PidGains = PidGains { p: 100.0, i: 10_000.0, d: 10.0 };

/// Gains of a device that has received none and has no weights, and of the PID to which the ladder falls. They suit a lung with
/// resistance 20 cmH2O/(L/s) and compliance 20 mL/cmH2O and are safe for exploration there; on a stiff lung with low resistance
/// the pressure oscillates.
pub const KNOWN_GOOD: PidGains = PidGains { p: 3.0, i: 30.0, d: 0.0 };

/// A gain that is negative, too large or not a number.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("PID gain {name} is {value}, allowed are 0 to {max}")]
pub struct GainError {
    /// `p`, `i` or `d`.
    pub name: &'static str,
    /// Requested value.
    pub value: f32,
    /// Largest accepted value.
    pub max: f32,
}

/// A PID built from [`PidGains`], with gains per tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pid {
    gains: PidGains,
    integral_step: f32,
    derivative_scale: f32,
    derivative_factor: f32,
}

/// State of a PID.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PidState {
    /// Integral part of the command, percent.
    pub integral: f32,
    /// Derivative part of the command, percent.
    pub derivative: f32,
    /// Last pressure, cmH2O; none at the start of a breath.
    pub pressure: Option<f32>,
}

impl PidState {
    /// State at the start of a breath.
    pub const fn new() -> Self {
        Self { integral: 0.0, derivative: 0.0, pressure: None }
    }
}

impl Default for PidState {
    fn default() -> Self {
        Self::new()
    }
}

impl Pid {
    /// Builds a PID for a control period in microseconds.
    ///
    /// # Errors
    /// A gain that is negative, above [`GAINS_MAX`] or not a number.
    pub fn new(gains: PidGains, period_us: u32) -> Result<Self, GainError> {
        let checks = [("p", gains.p, GAINS_MAX.p), ("i", gains.i, GAINS_MAX.i), ("d", gains.d, GAINS_MAX.d)];
        for (name, value, max) in checks {
            if !(value >= 0.0 && value <= max) {
                return Err(GainError { name, value, max });
            }
        }
        Ok(Self::build(gains, period_us))
    }

    /// The PID with [`KNOWN_GOOD`] gains, which depends on no image and no host.
    pub fn known_good(period_us: u32) -> Self {
        Self::build(KNOWN_GOOD, period_us)
    }

    fn build(gains: PidGains, period_us: u32) -> Self {
        let period = period_s(period_us);
        Self {
            gains,
            integral_step: gains.i * period,
            derivative_scale: gains.d / period,
            derivative_factor: math::lag_factor(DERIVATIVE_LAG, period),
        }
    }

    /// Gains from which the PID was built.
    #[inline]
    pub fn gains(&self) -> PidGains {
        self.gains
    }

    /// Integral gain per tick, percent per cmH2O.
    #[inline]
    pub fn integral_step(&self) -> f32 {
        self.integral_step
    }

    /// Derivative part per change of the pressure in one tick, before the filter, percent per cmH2O.
    #[inline]
    pub fn derivative_scale(&self) -> f32 {
        self.derivative_scale
    }

    /// Smoothing factor of the derivative's filter per tick.
    #[inline]
    pub fn derivative_factor(&self) -> f32 {
        self.derivative_factor
    }

    /// Computes one tick. `extra` is the residual, percent; the output holds the limited commands with and without it.
    ///
    /// The integral stays as it is while the command including `extra` is saturated and the error would drive it further.
    #[inline]
    pub fn step(&self, state: &mut PidState, seen: &Observation, extra: f32) -> ControlOutput {
        let error = seen.target - seen.pressure;
        let change = state.pressure.map_or(0.0, |last| seen.pressure - last);
        state.pressure = Some(seen.pressure);
        state.derivative += self.derivative_factor * (-self.derivative_scale * change - state.derivative);
        let base = self.gains.p * error + state.integral + state.derivative;
        let wanted = base + extra;
        let winds_up = (wanted >= COMMAND_MAX && error > 0.0) || (wanted <= 0.0 && error < 0.0);
        if !winds_up {
            state.integral =
                math::limit(state.integral + self.integral_step * error, -COMMAND_MAX, COMMAND_MAX);
        }
        let [base, command] = [base, wanted].map(|part| math::limit(part, 0.0, COMMAND_MAX));
        debug_assert!(!state.integral.is_nan(), "an integral that is no number would stay so");
        debug_assert!(command >= base || extra < 0.0 || extra.is_nan(), "a residual acts in its direction");
        ControlOutput { base, command }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::DEFAULT_PERIOD_US;
    use proptest::prelude::*;

    fn pid(p: f32, i: f32, d: f32) -> Pid {
        Pid::new(PidGains { p, i, d }, DEFAULT_PERIOD_US).unwrap()
    }

    fn seen(pressure: f32, target: f32) -> Observation {
        Observation { pressure, target, pip: target, peep: 5.0, tick: 0, rise_ticks: 0 }
    }

    #[test]
    fn the_proportional_part_follows_the_error() {
        let command = pid(2.0, 0.0, 0.0).step(&mut PidState::new(), &seen(10.0, 20.0), 0.0).command;
        assert!((command - 20.0).abs() < 1e-6);
    }

    #[test]
    fn the_integral_grows_by_gain_times_error_times_time() {
        let (pid, mut state) = (pid(0.0, 10.0, 0.0), PidState::new());
        for _ in 0..1000 {
            pid.step(&mut state, &seen(18.0, 20.0), 0.0);
        }
        assert!((state.integral - 20.0).abs() < 1e-2, "10 %/(cmH2O s) x 2 cmH2O x 1 s = 20 %");
    }

    #[test]
    fn the_integral_does_not_wind_up_while_the_command_is_saturated() {
        let (pid, mut state) = (pid(10.0, 100.0, 0.0), PidState::new());
        for _ in 0..500 {
            assert!((pid.step(&mut state, &seen(5.0, 35.0), 0.0).command - 100.0).abs() < 1e-6);
        }
        assert!(state.integral.abs() < 1e-6, "integral {}", state.integral);
    }

    /// The residual counts for the anti-windup even while the supervisor does not trust it.
    #[test]
    fn the_integral_does_not_wind_up_while_the_command_with_the_residual_is_saturated() {
        let (pid, mut state) = (pid(1.0, 100.0, 0.0), PidState::new());
        let mut steps = |extra| {
            for _ in 0..100 {
                pid.step(&mut state, &seen(18.0, 20.0), extra);
            }
            state.integral
        };
        assert!(steps(98.0).abs() < 1e-6);
        assert!((steps(0.0) - 20.0).abs() < 1e-2);
    }

    #[test]
    fn the_integral_does_not_wind_down_while_the_valve_is_closed_and_follows_an_error_that_brings_it_back() {
        let (pid, mut state) = (pid(10.0, 100.0, 0.0), PidState::new());
        for _ in 0..500 {
            assert!(pid.step(&mut state, &seen(35.0, 5.0), 0.0).command.abs() < f32::EPSILON);
        }
        assert!(state.integral.abs() < f32::EPSILON);
        let mut closed = PidState { integral: -50.0, ..PidState::new() };
        pid.step(&mut closed, &seen(19.0, 20.0), 0.0);
        assert!((closed.integral + 49.9).abs() < 1e-4, "100 %/(cmH2O s) x 1 cmH2O x 1 ms = 0.1 %");
        let mut open = PidState { integral: 100.0, ..PidState::new() };
        pid.step(&mut open, &seen(20.5, 20.0), 50.0);
        assert!((open.integral - 99.95).abs() < 1e-4);
    }

    #[test]
    fn the_gains_per_tick_are_those_of_the_period() {
        let gains = PidGains { p: 2.0, i: 30.0, d: 0.05 };
        let pid = Pid::new(gains, 2000).unwrap();
        assert_eq!(pid.gains(), gains);
        assert!((pid.integral_step() - 0.06).abs() < 1e-6);
        assert!((pid.derivative_scale() - 25.0).abs() < 1e-4);
        assert!((pid.derivative_factor() - 2.0 / 12.0).abs() < 1e-6, "2 ms of a lag of 10 ms");
    }

    #[test]
    fn the_derivative_brakes_a_rise_after_its_lag() {
        let (pid, mut state) = (pid(0.0, 0.0, 0.05), PidState::new());
        let mut pressure = 5.0;
        for _ in 0..100 {
            pressure += 0.1;
            pid.step(&mut state, &seen(pressure, 30.0), 0.0);
        }
        assert!((state.derivative + 5.0).abs() < 0.1, "-0.05 % s/cmH2O x 100 cmH2O/s = -5 %");
    }

    #[test]
    fn a_target_step_gives_no_derivative_kick() {
        let (pid, mut state) = (pid(0.0, 0.0, 1.0), PidState::new());
        pid.step(&mut state, &seen(5.0, 5.0), 0.0);
        pid.step(&mut state, &seen(5.0, 35.0), 0.0);
        assert!(state.derivative.abs() < 1e-9);
    }

    #[test]
    fn bad_gains_are_refused_by_name() {
        let refused = Pid::new(PidGains { p: 1.0, i: f32::NAN, d: 0.0 }, DEFAULT_PERIOD_US);
        assert!(matches!(refused, Err(GainError { name: "i", .. })));
    }

    proptest! {
        #[test]
        fn commands_stay_in_range_whatever_is_measured(pressure in prop::num::f32::ANY) {
            let (pid, mut state) = (pid(5.0, 50.0, 0.05), PidState::new());
            for _ in 0..3 {
                let command = pid.step(&mut state, &seen(pressure, 20.0), 0.0).command;
                prop_assert!((0.0..=100.0).contains(&command));
            }
        }
    }
}
