//! The inputs of the residual's network: recent errors and commands, leaky averages of both, the time since the
//! breath started, PIP and PEEP, and where the target goes, each scaled to about one.
//!
//! | index | feature |
//! |---|---|
//! | 0..7 | error, [`FeatureSpec::error_taps`] ticks ago |
//! | 7..13 | command, [`FeatureSpec::command_taps`] ticks ago |
//! | 13..15 | error, leaky averages |
//! | 15..17 | command, leaky averages |
//! | 17 | integral part of the PID |
//! | 18..21 | time since the start of the breath: `t / (t + tau)` for three `tau` |
//! | 21 | PIP |
//! | 22 | PEEP |
//! | 23..25 | rise of the target within [`FeatureSpec::target_ahead`] ticks |
//!
//! A breath knows its own future: the last group lets the valve, which acts late, move in time with a slow rise.

use core::ops::Range;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::Observation;
use crate::breath::period_s;
use crate::math;

/// Number of error taps.
pub const ERROR_TAPS: usize = 7;
/// Number of command taps.
pub const COMMAND_TAPS: usize = 6;
/// Number of leaky averages of each signal.
pub const AVERAGES: usize = 2;
/// Number of time features.
pub const TIMES: usize = 3;
/// Indices of past errors.
pub const PAST_ERRORS: Range<usize> = 0..ERROR_TAPS;
/// Indices of past commands.
pub const PAST_COMMANDS: Range<usize> = PAST_ERRORS.end..PAST_ERRORS.end + COMMAND_TAPS;
/// Indices of the leaky averages: of the error, then of the command.
pub const LEAKY: Range<usize> = PAST_COMMANDS.end..PAST_COMMANDS.end + 2 * AVERAGES;
/// Index of the PID's integral.
pub const INTEGRAL: usize = LEAKY.end;
/// Indices of the time features.
pub const CLOCK: Range<usize> = INTEGRAL + 1..INTEGRAL + 1 + TIMES;
/// Number of times ahead at which the target is seen.
pub const AHEAD: usize = 2;
/// Index of PIP; PEEP follows.
pub const PIP: usize = CLOCK.end;
/// Indices of the rise of the target.
pub const RISE: Range<usize> = PIP + 2..PIP + 2 + AHEAD;
/// Length of the feature vector.
pub const FEATURES: usize = RISE.end;
/// Highest age of a tap, ticks.
pub const TAP_MAX: u8 = (HISTORY - 1) as u8;

/// Entries of a history; a power of two, so that indexing the ring is a bit mask.
const HISTORY: usize = 128;

/// Error that is scaled to one, cmH2O.
pub const ERROR_SCALE: f32 = 10.0;
/// Command that is scaled to one, percent.
pub const COMMAND_SCALE: f32 = 50.0;
/// PIP that is scaled to zero, and the distance from it that is scaled to one, cmH2O.
pub const PIP_SCALE: (f32, f32) = (20.0, 15.0);
/// PEEP that is scaled to zero, and the distance from it that is scaled to one, cmH2O.
pub const PEEP_SCALE: (f32, f32) = (5.0, 5.0);

/// Ages and time constants of the features. Stored with the weights, which are valid only for these features.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureSpec {
    /// Ages of the errors, ticks; 0 is the current error.
    pub error_taps: [u8; ERROR_TAPS],
    /// Ages of the commands, ticks; 1 is the last one applied.
    pub command_taps: [u8; COMMAND_TAPS],
    /// Time constants of the error's leaky averages, s.
    pub error_averages: [f32; AVERAGES],
    /// Time constants of the command's leaky averages, s.
    pub command_averages: [f32; AVERAGES],
    /// Time constants of the time features, s.
    pub times: [f32; TIMES],
    /// Ticks ahead at which the target is seen: about the dead time and lag of a valve.
    pub target_ahead: [u8; AHEAD],
}

impl Default for FeatureSpec {
    /// For a control period of 1 ms: the taps cover the valve's dead time and lag.
    fn default() -> Self {
        Self {
            error_taps: [0, 2, 4, 8, 16, 32, 64],
            command_taps: [1, 2, 4, 8, 16, 32],
            error_averages: [0.02, 0.1],
            command_averages: [0.05, 0.3],
            times: [0.02, 0.1, 0.5],
            target_ahead: [10, 40],
        }
    }
}

/// Reason for refusing a [`FeatureSpec`].
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FeatureError {
    /// The age of a tap is out of bounds.
    #[error("the age of a tap is {0} ticks; allowed are 0 (commands: 1) to {TAP_MAX}")]
    Tap(u8),
    /// A time constant is not positive and finite.
    #[error("a time constant is {0} s; it must be positive and finite")]
    TimeConstant(f32),
}

impl FeatureSpec {
    /// The default up to a control period of 2 ms; for longer periods mostly consecutive ticks, to cover a similar time.
    pub fn for_period(period_us: u32) -> Self {
        let spec = Self::default();
        if period_us <= 2000 {
            return spec;
        }
        Self {
            error_taps: [0, 1, 2, 3, 4, 6, 8],
            command_taps: [1, 2, 3, 4, 5, 6],
            target_ahead: [1, 4],
            ..spec
        }
    }

    /// Checks taps and time constants.
    ///
    /// # Errors
    /// The first value out of bounds.
    pub fn validate(&self) -> Result<(), FeatureError> {
        let taps = self.error_taps.iter().chain(&self.command_taps);
        if let Some(tap) = taps.chain(&[]).find(|tap| **tap > TAP_MAX) {
            return Err(FeatureError::Tap(*tap));
        }
        if self.command_taps.contains(&0) {
            return Err(FeatureError::Tap(0));
        }
        let constants = self.error_averages.iter().chain(&self.command_averages).chain(&self.times);
        match constants.into_iter().find(|tau| !(**tau > 0.0 && tau.is_finite())) {
            Some(tau) => Err(FeatureError::TimeConstant(*tau)),
            None => Ok(()),
        }
    }
}

/// A built [`FeatureSpec`], with smoothing factors per tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Features {
    spec: FeatureSpec,
    period: f32,
    error_factors: [f32; AVERAGES],
    command_factors: [f32; AVERAGES],
}

/// Past of one signal: a ring of its last values, and its leaky averages.
#[derive(Clone, Debug, PartialEq)]
struct History {
    ring: [f32; HISTORY],
    averages: [f32; AVERAGES],
}

impl History {
    const fn new() -> Self {
        Self { ring: [0.0; HISTORY], averages: [0.0; AVERAGES] }
    }

    fn fill(&mut self, value: f32) {
        self.ring = [value; HISTORY];
        self.averages = [value; AVERAGES];
    }

    fn push(&mut self, at: u32, value: f32, factors: [f32; AVERAGES]) {
        self.ring[at as usize % HISTORY] = value;
        for (average, factor) in self.averages.iter_mut().zip(factors) {
            *average += factor * (value - *average);
        }
    }

    fn ago(&self, at: u32, tap: u8) -> f32 {
        debug_assert!(tap <= TAP_MAX, "validated");
        self.ring[at.wrapping_sub(u32::from(tap)) as usize % HISTORY]
    }
}

/// Histories of error and command, both in scaled units.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureState {
    errors: History,
    commands: History,
    tick: u32,
}

impl FeatureState {
    /// Empty histories.
    pub const fn new() -> Self {
        Self { errors: History::new(), commands: History::new(), tick: 0 }
    }

    /// The present error, scaled.
    #[inline]
    pub fn error(&self) -> f32 {
        self.errors.ago(self.tick, 0)
    }

    /// Clears the last breath: past errors are zero, past commands are `command` percent.
    pub fn start_breath(&mut self, command: f32) {
        self.errors.fill(0.0);
        self.commands.fill(command / COMMAND_SCALE);
        self.tick = 0;
    }
}

impl Default for FeatureState {
    fn default() -> Self {
        Self::new()
    }
}

impl Features {
    /// Builds the features for a control period in microseconds.
    ///
    /// # Errors
    /// An error of [`FeatureSpec::validate`].
    pub fn new(spec: FeatureSpec, period_us: u32) -> Result<Self, FeatureError> {
        spec.validate()?;
        let period = period_s(period_us);
        let factors = |taus: [f32; AVERAGES]| taus.map(|tau| math::lag_factor(tau, period));
        Ok(Self {
            spec,
            period,
            error_factors: factors(spec.error_averages),
            command_factors: factors(spec.command_averages),
        })
    }

    /// Specification from which the features were built.
    #[inline]
    pub fn spec(&self) -> &FeatureSpec {
        &self.spec
    }

    /// Smoothing factors per tick of the error's leaky averages.
    #[inline]
    pub fn error_factors(&self) -> &[f32; AVERAGES] {
        &self.error_factors
    }

    /// Smoothing factors per tick of the command's leaky averages.
    #[inline]
    pub fn command_factors(&self) -> &[f32; AVERAGES] {
        &self.command_factors
    }

    /// Records this tick's observation and returns the feature vector; `integral` is the PID's, percent.
    pub fn step(&self, state: &mut FeatureState, seen: &Observation, integral: f32) -> [f32; FEATURES] {
        let error = (seen.target - seen.pressure) / ERROR_SCALE;
        state.errors.push(state.tick, error, self.error_factors);
        let errors = self.spec.error_taps.map(|tap| state.errors.ago(state.tick, tap));
        let commands = self.spec.command_taps.map(|tap| state.commands.ago(state.tick, tap));
        let mut features = [0.0; FEATURES];
        // Group by group: one chained iterator would test for every value which group it is in.
        let mut places = features.iter_mut();
        let mut put = |group: &[f32]| {
            for (value, place) in group.iter().zip(places.by_ref()) {
                *place = *value;
            }
        };
        put(&errors);
        put(&commands);
        put(&state.errors.averages);
        put(&state.commands.averages);
        put(&self.clocked(seen, integral));
        put(&self.spec.target_ahead.map(|ticks| seen.rise_within(u32::from(ticks)) / ERROR_SCALE));
        features
    }

    /// Features that need neither history nor future: integral, times, PIP, PEEP.
    fn clocked(&self, seen: &Observation, integral: f32) -> [f32; 3 + TIMES] {
        let times = self.times(seen.tick);
        [
            integral / COMMAND_SCALE,
            times[0],
            times[1],
            times[2],
            (seen.pip - PIP_SCALE.0) / PIP_SCALE.1,
            (seen.peep - PEEP_SCALE.0) / PEEP_SCALE.1,
        ]
    }

    /// Time features at a tick of the breath.
    pub fn times(&self, tick: u32) -> [f32; TIMES] {
        let time = tick as f32 * self.period;
        self.spec.times.map(|tau| time / (time + tau))
    }

    /// Records the command applied in this tick, percent, and ends the tick.
    pub fn applied(&self, state: &mut FeatureState, command: f32) {
        state.commands.push(state.tick, command / COMMAND_SCALE, self.command_factors);
        state.tick = state.tick.wrapping_add(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::DEFAULT_PERIOD_US;
    use proptest::prelude::*;

    fn features() -> Features {
        Features::new(FeatureSpec::default(), DEFAULT_PERIOD_US).unwrap()
    }

    #[test]
    fn the_parts_of_the_vector_follow_each_other_without_a_gap() {
        assert_eq!((PAST_ERRORS.start, PAST_ERRORS.end), (0, PAST_COMMANDS.start));
        assert_eq!((PAST_COMMANDS.end, LEAKY.end), (LEAKY.start, INTEGRAL));
        assert_eq!((CLOCK.start, CLOCK.len(), CLOCK.end), (INTEGRAL + 1, TIMES, PIP));
        assert_eq!((RISE.start, RISE.len(), RISE.end), (PIP + 2, AHEAD, FEATURES));
    }

    fn seen(error: f32, tick: u32) -> Observation {
        Observation { pressure: 20.0 - error, target: 20.0, pip: 20.0, peep: 5.0, tick, rise_ticks: 0 }
    }

    /// Runs `n` ticks with error = tick and command = 2 x tick; returns the last tick's features.
    fn ramp(n: u32) -> [f32; FEATURES] {
        let (features, mut state) = (features(), FeatureState::new());
        state.start_breath(0.0);
        let mut last = [0.0; FEATURES];
        for tick in 0..n {
            last = features.step(&mut state, &seen(tick as f32, tick), 0.0);
            features.applied(&mut state, 2.0 * tick as f32);
        }
        last
    }

    #[test]
    fn taps_look_back_by_their_age() {
        let last = ramp(300);
        for (index, tap) in FeatureSpec::default().error_taps.iter().enumerate() {
            assert!((last[index] * ERROR_SCALE - (299.0 - f32::from(*tap))).abs() < 1e-3);
        }
        for (index, tap) in FeatureSpec::default().command_taps.iter().enumerate() {
            assert!(
                (last[ERROR_TAPS + index] * COMMAND_SCALE - 2.0 * (299.0 - f32::from(*tap))).abs() < 1e-3
            );
        }
    }

    #[test]
    fn a_new_breath_knows_nothing_of_the_last() {
        let (features, mut state) = (features(), FeatureState::new());
        let fresh = |state: &mut FeatureState| {
            state.start_breath(5.0);
            features.step(state, &seen(15.0, 0), 0.0).map(f32::to_bits)
        };
        let first = fresh(&mut state);
        for tick in 0..200 {
            features.step(&mut state, &seen(3.0, tick), 7.0);
            features.applied(&mut state, 40.0);
        }
        assert_eq!(fresh(&mut state), first);
    }

    #[test]
    fn leaky_averages_settle_on_a_constant() {
        let (features, mut state) = (features(), FeatureState::new());
        state.start_breath(0.0);
        for tick in 0..3000 {
            features.step(&mut state, &seen(5.0, tick), 0.0);
            features.applied(&mut state, 25.0);
        }
        let last = features.step(&mut state, &seen(5.0, 3000), 0.0);
        let averages = &last[ERROR_TAPS + COMMAND_TAPS..];
        assert!((averages[0] - 0.5).abs() < 1e-3 && (averages[1] - 0.5).abs() < 1e-3);
        assert!((averages[2] - 0.5).abs() < 1e-3 && (averages[3] - 0.5).abs() < 1e-2);
    }

    #[test]
    fn a_spec_beyond_the_history_is_refused() {
        let spec = FeatureSpec { error_taps: [0, 2, 4, 8, 16, 32, 200], ..FeatureSpec::default() };
        assert_eq!(spec.validate(), Err(FeatureError::Tap(200)));
        let spec = FeatureSpec { command_taps: [0, 2, 4, 8, 16, 32], ..FeatureSpec::default() };
        assert_eq!(spec.validate(), Err(FeatureError::Tap(0)), "the current command is not known yet");
        let spec = FeatureSpec { times: [0.1, f32::NAN, 0.2], ..FeatureSpec::default() };
        assert!(matches!(spec.validate(), Err(FeatureError::TimeConstant(_))));
    }

    #[test]
    fn taps_reach_to_the_end_of_the_history_and_time_constants_are_positive_numbers() {
        let with = |tap, tau| FeatureSpec {
            error_taps: [0, 2, 4, 8, 16, 32, tap],
            command_averages: [0.05, tau],
            ..FeatureSpec::default()
        };
        assert_eq!(with(127, 0.3).validate(), Ok(()));
        assert_eq!(with(128, 0.3).validate(), Err(FeatureError::Tap(128)));
        for tau in [0.0, -0.1, f32::INFINITY] {
            assert_eq!(with(64, tau).validate(), Err(FeatureError::TimeConstant(tau)));
        }
    }

    #[test]
    fn taps_of_long_periods_are_consecutive_ticks() {
        assert_eq!(FeatureSpec::for_period(2000), FeatureSpec::default());
        let long = FeatureSpec::for_period(2001);
        assert_eq!((long.error_taps[3], long.command_taps[3]), (3, 4));
        assert_eq!(long.validate(), Ok(()));
    }

    #[test]
    fn averages_take_in_their_share_of_each_tick() {
        let features = features();
        let [errors, commands] = [features.error_factors(), features.command_factors()];
        for (factor, lag) in errors.iter().chain(commands).zip([0.02_f32, 0.1, 0.05, 0.3]) {
            assert!((factor - 0.001 / (lag + 0.001)).abs() < 1e-6, "{lag} s");
        }
    }

    #[test]
    fn the_rise_of_the_target_is_seen_ahead_until_the_plateau() {
        let features = features();
        let at = |tick| {
            let seen = Observation {
                pressure: 5.0,
                target: 5.0 + 0.1 * (tick as f32).min(100.0),
                pip: 15.0,
                peep: 5.0,
                tick,
                rise_ticks: 100,
            };
            let vector = features.step(&mut FeatureState::new(), &seen, 0.0);
            [0, 1].map(|n| (100.0 * vector[RISE.start + n]).round() as i32)
        };
        assert_eq!(at(0), [10, 40]);
        assert_eq!(at(70), [10, 30]);
        assert_eq!(at(100), [0, 0]);
    }

    proptest! {
        #[test]
        fn features_are_finite_and_about_one(errors in prop::collection::vec(-40.0f32..40.0, 1..200)) {
            let (features, mut state) = (features(), FeatureState::new());
            state.start_breath(5.0);
            for (tick, error) in errors.iter().enumerate() {
                let vector = features.step(&mut state, &seen(*error, tick as u32), 50.0);
                prop_assert!(vector.iter().all(|x| x.abs() <= 4.0));
                features.applied(&mut state, 100.0);
            }
        }
    }
}
