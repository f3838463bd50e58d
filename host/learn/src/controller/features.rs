//! The residual's features over lanes, forward and backward: the same as [`shared::control::features`] on the chip.

use engine::Lane;
use shared::control::features::{
    AVERAGES, CLOCK, COMMAND_SCALE, ERROR_SCALE, Features, INTEGRAL, LEAKY, PAST_COMMANDS, PEEP_SCALE, PIP,
    PIP_SCALE, RISE,
};

use super::scenario::{Prescribed, Scenario};
use super::signals::Signals;

/// Index of the first leaky average of the command.
const COMMAND_AVERAGES_AT: usize = LEAKY.start + AVERAGES;

/// Scaled leaky averages of error and command; in the backward pass, the gradients with respect to them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Averages {
    error: [Lane; AVERAGES],
    command: [Lane; AVERAGES],
}

/// The features of a breath.
#[derive(Debug)]
pub(super) struct LaneFeatures<'a> {
    features: &'a Features,
    /// Scaled command before the breath.
    rest: Lane,
    /// The waveforms.
    prescribed: &'a Prescribed,
    /// Last tick that the clock shows.
    held_tick: usize,
    /// Scaled PIP and PEEP.
    pressures: [Lane; 2],
}

impl<'a> LaneFeatures<'a> {
    /// Features of the breaths of a shard.
    pub fn new(features: &'a Features, scenario: &'a Scenario) -> Self {
        let Prescribed { pip, peep, .. } = &scenario.prescribed;
        let scaled = |pressure: &Lane, (zero, one)| pressure.map(|pressure| (pressure - zero) / one);
        Self {
            features,
            rest: scenario.rest.map(|rest| rest / COMMAND_SCALE),
            prescribed: &scenario.prescribed,
            held_tick: scenario.held_tick,
            pressures: [scaled(pip, PIP_SCALE), scaled(peep, PEEP_SCALE)],
        }
    }

    /// Averages at the start of a breath.
    pub fn start(&self) -> Averages {
        Averages { error: [Lane::ZERO; AVERAGES], command: [self.rest; AVERAGES] }
    }

    /// Processes the error of a tick; writes the features, including the PID's integral (percent).
    pub fn forward(
        &self,
        averages: &mut Averages,
        signals: &Signals,
        integral: &Lane,
        tick: usize,
        out: &mut [Lane],
    ) {
        let spec = self.features.spec();
        let error = &signals.error[tick];
        for (average, factor) in averages.error.iter_mut().zip(self.features.error_factors()) {
            *average = average.zip(error, |a, e| a + factor * (e / ERROR_SCALE - a));
        }
        for (feature, tap) in out.iter_mut().zip(spec.error_taps) {
            *feature = match tick.checked_sub(usize::from(tap)) {
                Some(then) => signals.error[then].map(|e| e / ERROR_SCALE),
                None => Lane::ZERO,
            };
        }
        for (feature, tap) in out[PAST_COMMANDS.start..].iter_mut().zip(spec.command_taps) {
            *feature = match tick.checked_sub(usize::from(tap)) {
                Some(then) => signals.command[then].map(|u| u / COMMAND_SCALE),
                None => self.rest,
            };
        }
        out[LEAKY.start..COMMAND_AVERAGES_AT].copy_from_slice(&averages.error);
        out[COMMAND_AVERAGES_AT..INTEGRAL].copy_from_slice(&averages.command);
        out[INTEGRAL] = integral.map(|i| i / COMMAND_SCALE);
        for (feature, time) in
            out[CLOCK.start..].iter_mut().zip(self.features.times(tick.min(self.held_tick) as u32))
        {
            *feature = Lane::splat(time);
        }
        [out[PIP], out[PIP + 1]] = self.pressures;
        let target = self.prescribed.target(tick);
        for (feature, ticks) in out[RISE].iter_mut().zip(spec.target_ahead) {
            let then = self.prescribed.target(tick + usize::from(ticks));
            *feature = then.zip(target, |then, now| (then - now) / ERROR_SCALE);
        }
    }

    /// Records the command applied in the tick, percent.
    pub fn applied(&self, averages: &mut Averages, command: &Lane) {
        for (average, factor) in averages.command.iter_mut().zip(self.features.command_factors()) {
            *average = average.zip(command, |a, u| a + factor * (u / COMMAND_SCALE - a));
        }
    }

    /// Backward pass of [`Self::applied`]: adds the gradient with respect to the command.
    pub fn applied_back(&self, back: &mut Averages, d_command: &mut Lane) {
        for (d, factor) in back.command.iter_mut().zip(self.features.command_factors()) {
            d_command.add_scaled(factor / COMMAND_SCALE, d);
            *d = d.map(|d| (1.0 - factor) * d);
        }
    }

    /// Backward pass of [`Self::forward`]: adds the gradients with respect to signals and integral.
    pub fn backward(
        &self,
        back: &mut Averages,
        d: &[Lane],
        tick: usize,
        d_signals: &mut Signals,
        d_integral: &mut Lane,
    ) {
        let spec = self.features.spec();
        for (d, tap) in d.iter().zip(spec.error_taps) {
            if let Some(then) = tick.checked_sub(usize::from(tap)) {
                d_signals.error[then].add_scaled(1.0 / ERROR_SCALE, d);
            }
        }
        for (d, tap) in d[PAST_COMMANDS.start..].iter().zip(spec.command_taps) {
            if let Some(then) = tick.checked_sub(usize::from(tap)) {
                d_signals.command[then].add_scaled(1.0 / COMMAND_SCALE, d);
            }
        }
        let factors = self.features.error_factors();
        for ((carried, d), factor) in back.error.iter_mut().zip(&d[LEAKY.start..]).zip(factors) {
            carried.add_scaled(1.0, d);
            d_signals.error[tick].add_scaled(factor / ERROR_SCALE, carried);
            *carried = carried.map(|d| (1.0 - factor) * d);
        }
        for (carried, d) in back.command.iter_mut().zip(&d[COMMAND_AVERAGES_AT..]) {
            carried.add_scaled(1.0, d);
        }
        d_integral.add_scaled(1.0 / COMMAND_SCALE, &d[INTEGRAL]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;
    use engine::LANES;
    use shared::control::features::{FEATURES, FeatureSpec};

    const TICKS: usize = 100;

    fn weight(tick: usize, feature: usize) -> f32 {
        10.0 * ((7 * tick + 3 * feature) as f32).cos()
    }

    /// Weighted sum of all features of all ticks, with different weights; every lane has the same signals.
    fn run(built: &LaneFeatures<'_>, errors: &[f32], commands: &[f32]) -> f64 {
        let mut averages = built.start();
        let signals = Signals {
            error: errors.iter().map(|e| Lane::splat(*e)).collect(),
            command: commands.iter().map(|u| Lane::splat(*u)).collect(),
        };
        let mut total = 0.0;
        for tick in 0..TICKS {
            let mut out = [Lane::ZERO; FEATURES];
            built.forward(&mut averages, &signals, &Lane::ZERO, tick, &mut out);
            built.applied(&mut averages, &signals.command[tick]);
            total += (0..FEATURES).map(|n| f64::from(weight(tick, n) * out[n][LANES - 1])).sum::<f64>();
        }
        total
    }

    #[test]
    fn gradients_by_errors_and_commands_agree_with_finite_differences() {
        let features = Features::new(FeatureSpec::default(), 1000).unwrap();
        let scenario = Scenario::plain(TICKS, Lane::splat(20.0));
        let built = LaneFeatures::new(&features, &scenario);
        let errors: Vec<f32> = (0..TICKS).map(|tick| (0.3 * tick as f32).sin()).collect();
        let commands: Vec<f32> = (0..TICKS).map(|tick| 40.0 + 5.0 * (0.2 * tick as f32).cos()).collect();
        let (mut back, mut d_signals) = (Averages::default(), Signals::new(TICKS));
        let mut d_integral = Lane::ZERO;
        for tick in (0..TICKS).rev() {
            built.applied_back(&mut back, &mut d_signals.command[tick]);
            let d: [Lane; FEATURES] = std::array::from_fn(|n| Lane::splat(weight(tick, n)));
            built.backward(&mut back, &d, tick, &mut d_signals, &mut d_integral);
        }
        let first = |lanes: &[Lane]| -> Vec<f32> { lanes.iter().map(|lane| lane[0]).collect() };
        check_slopes("error", &errors, 1e-2, &first(&d_signals.error), |varied| {
            run(&built, varied, &commands)
        });
        check_slopes("command", &commands, 1.0, &first(&d_signals.command), |varied| {
            run(&built, &errors, varied)
        });
        let by_integral: f32 = (0..TICKS).map(|tick| weight(tick, INTEGRAL) / COMMAND_SCALE).sum();
        assert!((d_integral[0] - by_integral).abs() < 1e-3);
    }
}
