//! The residual's incremental gain: what a small change of the measured pressure does to the residual, in the states of real breaths.
//!
//! In each recorded state the network is replaced by its Jacobian. Together with the linear filters that make its inputs (taps and
//! averages of errors and of the law's own commands, and the PID's integral) it is a transfer function R(jw) from pressure to
//! residual. By the small-gain theorem the residual cannot destabilise its PID's loop while abs(R) abs(P S) stays below one at every
//! frequency, where P S is the response of that loop to an addition to its command. This is sufficient, not necessary: a residual that
//! acts in the right phase may exceed it.

use std::array::from_fn;
use std::f64::consts::TAU;

use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use shared::breath::{Breath, Phase, paper_settings, period_s};
use shared::control::features::{
    COMMAND_SCALE, ERROR_SCALE, FEATURES, Features, INTEGRAL, LEAKY, PAST_COMMANDS, PAST_ERRORS,
};
use shared::control::memory::Lesson;
use shared::control::network::INPUTS;
use shared::control::pid::Pid;
use shared::control::residual::Residual;
use shared::control::{ControlLaw, Controller, ControllerState, Observation};
use shared::settings::{LIMIT_MARGIN, Settings};

use super::MeasuredPoint;
use super::operating_point::OperatingPoint;
use plant::bench::{Bench, BenchConfig, BenchError, steps_per_period};

/// Breaths whose states are recorded, at each PIP.
const BREATHS: u32 = 2;
/// A state is recorded in every tick with this distance.
const EVERY: u32 = 5;
/// Step of the finite differences, in the units of the features.
const STEP: f32 = 1e-2;

/// The largest value of a gain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Largest {
    /// The value.
    pub value: f64,
    /// Frequency at which it occurs, Hz.
    pub hz: f64,
    /// PIP of the breath in which it occurs, cmH2O.
    pub pip: f32,
}

/// The residual's incremental gain over all recorded states and frequencies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResidualGain {
    /// Largest response of the residual to the pressure while the inputs of past commands stay as they are, percent per cmH2O.
    pub direct: Largest,
    /// Largest abs(R), percent per cmH2O: past commands are those that the law itself has given.
    pub residual: Largest,
    /// Largest abs(R) abs(P S), without unit.
    pub times_loop: Largest,
}

impl ResidualGain {
    /// The gain in breaths on a plant. `pids` are the loops of the PID underneath, measured at the operating points of the breaths;
    /// `seed` is that of the sensor noise.
    ///
    /// # Errors
    /// A bench that cannot be built, or a control period that it cannot run.
    pub fn of(
        residual: &Residual,
        plant: &BenchConfig,
        pids: &[MeasuredPoint],
        seed: u64,
    ) -> Result<Self, BenchError> {
        let mut found = Self::default();
        for measured in pids {
            let OperatingPoint { pip, peep, .. } = measured.point;
            let pressure_limit = Settings::default().pressure_limit.max(pip + LIMIT_MARGIN);
            let settings = Settings { peep, pressure_limit, ..paper_settings(pip) };
            let jacobians: Vec<_> = states(residual, plant, &settings, seed)?
                .iter()
                .map(|state| jacobian(residual, state))
                .collect();
            for response in &measured.response {
                let inputs = Inputs::at(residual, response.hz);
                let largest = |gain: &dyn Fn(&[f64; FEATURES]) -> Complex64| {
                    jacobians.iter().map(|row| gain(row).norm()).fold(0.0, f64::max)
                };
                let highest = largest(&|row| inputs.residual(row));
                found.direct.raise(largest(&|row| combined(&inputs.error, row)), response.hz, pip);
                found.residual.raise(highest, response.hz, pip);
                found.times_loop.raise(highest * response.path.norm(), response.hz, pip);
            }
        }
        Ok(found)
    }

    /// The larger of two gains, each by itself.
    #[must_use]
    pub fn worst(mut self, other: &Self) -> Self {
        self.direct.raise(other.direct.value, other.direct.hz, other.direct.pip);
        self.residual.raise(other.residual.value, other.residual.hz, other.residual.pip);
        self.times_loop.raise(other.times_loop.value, other.times_loop.hz, other.times_loop.pip);
        self
    }
}

impl Largest {
    fn raise(&mut self, value: f64, hz: f64, pip: f32) {
        if value > self.value {
            *self = Self { value, hz, pip };
        }
    }
}

/// The network's inputs in breaths with these settings, on the bench without monitors.
fn states(
    residual: &Residual,
    plant: &BenchConfig,
    settings: &Settings,
    seed: u64,
) -> Result<Vec<[f32; INPUTS]>, BenchError> {
    let period_us = residual.spec().period_us;
    let steps = steps_per_period(period_us)?;
    let breath = Breath::new(settings, period_us)
        .expect("the paper's timing, checked pressures and a built controller's period are valid");
    let mut bench = Bench::new(plant, settings.peep, seed)?;
    let (mut pressure, mut command) = (settings.peep, 0.0);
    let mut states = Vec::new();
    let (controller, mut state) = (Controller::Residual(residual.clone()), ControllerState::new());
    for _ in 0..BREATHS {
        controller.start_breath(&mut state, command);
        for tick in 0..breath.total_ticks() {
            let inspiration = breath.phase(tick) == Phase::Inspiration;
            command = if inspiration {
                let seen = Observation::at(&breath.at(tick), pressure);
                if tick % EVERY == 0 {
                    states.push(residual.inputs(&mut state.clone(), &seen));
                }
                let command = controller.step(&mut state, &seen).command;
                controller.applied(&mut state, command);
                command
            } else {
                settings.expiratory_bias
            };
            for _ in 0..steps {
                pressure = bench.step(command, !inspiration);
            }
        }
        controller.learn(&mut state, Lesson::Adopt);
    }
    Ok(states)
}

/// Derivatives of the residual by the features, percent; what the network recalls of earlier breaths does not depend on the running one.
fn jacobian(residual: &Residual, state: &[f32; INPUTS]) -> [f64; FEATURES] {
    let at = |place: usize, step: f32| {
        let mut moved = *state;
        moved[place] += step;
        f64::from(residual.correction(residual.network().forward(&moved)))
    };
    from_fn(|place| (at(place, STEP) - at(place, -STEP)) / (2.0 * f64::from(STEP)))
}

/// Responses of the network's inputs at one frequency.
struct Inputs {
    /// To the error, per cmH2O.
    error: [Complex64; FEATURES],
    /// To the command, per percent.
    command: [Complex64; FEATURES],
    /// The PID, percent per cmH2O.
    pid: Complex64,
}

impl Inputs {
    fn at(residual: &Residual, hz: f64) -> Self {
        let period = f64::from(period_s(residual.spec().period_us));
        let tick = |ticks: f64| Complex64::cis(-TAU * hz * period * ticks);
        let features = residual.features();
        let (mut error, mut command) = ([Complex64::default(); FEATURES], [Complex64::default(); FEATURES]);
        let (per_error, per_command) = (1.0 / f64::from(ERROR_SCALE), 1.0 / f64::from(COMMAND_SCALE));
        for (place, tap) in PAST_ERRORS.zip(features.spec().error_taps) {
            error[place] = tick(f64::from(tap)) * per_error;
        }
        for (place, tap) in PAST_COMMANDS.zip(features.spec().command_taps) {
            command[place] = tick(f64::from(tap)) * per_command;
        }
        let (errors, commands) = averages(features);
        for (place, factor) in LEAKY.zip(errors) {
            error[place] = leaky(factor, tick(1.0)) * per_error;
        }
        // An average of the commands ends with the one before the present.
        for (place, factor) in LEAKY.skip(errors.len()).zip(commands) {
            command[place] = (leaky(factor, tick(1.0)) * tick(1.0)) * per_command;
        }
        error[INTEGRAL] = integral(residual.pid(), tick(1.0)) * per_command;
        Self { error, command, pid: pid(residual.pid(), tick(1.0)) }
    }

    /// The residual with this Jacobian, as a response to the error: the law's own commands feed back into it.
    fn residual(&self, jacobian: &[f64; FEATURES]) -> Complex64 {
        let (by_error, by_command) = (combined(&self.error, jacobian), combined(&self.command, jacobian));
        (by_error + by_command * self.pid) / (Complex64::ONE - by_command)
    }
}

/// Response of the residual with this Jacobian, through inputs with these responses.
fn combined(responses: &[Complex64; FEATURES], jacobian: &[f64; FEATURES]) -> Complex64 {
    responses.iter().zip(jacobian).map(|(response, slope)| response * *slope).sum()
}

/// Smoothing factors of the averages of errors and of commands.
fn averages(features: &Features) -> ([f64; 2], [f64; 2]) {
    (features.error_factors().map(f64::from), features.command_factors().map(f64::from))
}

/// Response of a leaky average with this smoothing factor; `late` is that of a delay of one tick.
fn leaky(factor: f64, late: Complex64) -> Complex64 {
    Complex64::from(factor) / (Complex64::ONE - late * (1.0 - factor))
}

/// Response of the PID's integral to the error, before it takes the present one.
fn integral(pid: &Pid, late: Complex64) -> Complex64 {
    late * f64::from(pid.integral_step()) / (Complex64::ONE - late)
}

/// Response of a PID to the error at a constant target; `late` is that of a delay of one tick.
pub(super) fn pid(pid: &Pid, late: Complex64) -> Complex64 {
    let change = (Complex64::ONE - late) * f64::from(pid.derivative_scale());
    let derivative = change * leaky(f64::from(pid.derivative_factor()), late);
    Complex64::from(f64::from(pid.gains().p)) + integral(pid, late) + derivative
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::control::features::FeatureSpec;
    use shared::control::features::FeatureState;
    use shared::control::memory::RECALLED;
    use shared::control::network::Network;
    use shared::control::pid::PidGains;
    use shared::control::pid::PidState;
    use shared::control::residual::ResidualSpec;
    use shared::control::residual::with_recalled;

    /// A learned controller whose network passes one input on with this weight: softsign is the identity near zero.
    fn passing(place: usize, weight: f32) -> Residual {
        let mut network = Network::zero();
        network.hidden_1.weights[place][0] = 1e-3;
        network.hidden_2.weights[0][0] = 1.0;
        network.output.weights[0][0] = 1e3 * weight;
        let spec = ResidualSpec {
            period_us: 1000,
            gains: PidGains { p: 2.0, i: 40.0, d: 0.05 },
            lambda: 1.0,
            authority: 100.0,
            features: FeatureSpec::default(),
        };
        Residual::new(spec, network).unwrap()
    }

    #[test]
    fn the_jacobian_is_the_slope_by_each_input() {
        let row = jacobian(&passing(3, 0.2), &[0.01; INPUTS]);
        for (place, slope) in row.iter().enumerate() {
            let expected = if place == 3 { 20.0 } else { 0.0 };
            assert!((slope - expected).abs() < 0.02, "{place}: {slope}");
        }
    }

    /// Runs features and PID on a sine of the error; compares the response of one input with that of the formula.
    fn simulated(place: usize, hz: f64) -> (Complex64, Complex64) {
        let residual = passing(place, 0.05);
        let (mut past, mut state) = (FeatureState::new(), PidState::new());
        past.start_breath(0.0);
        let angle = |tick: u32| TAU * hz * f64::from(tick) * 1e-3;
        let (mut error, mut extra) = (Complex64::default(), Complex64::default());
        for tick in 0..8000 {
            let wave = angle(tick).sin() as f32;
            let seen = Observation {
                pressure: 20.0 - wave,
                target: 20.0,
                pip: 20.0,
                peep: 5.0,
                tick,
                rise_ticks: 0,
            };
            let features = residual.features().step(&mut past, &seen, state.integral);
            let inputs = with_recalled(&features, &[0.0; RECALLED]);
            let correction = residual.correction(residual.network().forward(&inputs));
            // Around a command of 50 percent, nothing is limited.
            let output = residual.pid().step(&mut state, &seen, 50.0 + correction);
            residual.features().applied(&mut past, output.command - 50.0);
            if tick >= 4000 {
                let turn = Complex64::cis(-angle(tick));
                error += turn * f64::from(wave);
                extra += turn * f64::from(correction);
            }
        }
        let expected = Inputs::at(&residual, hz).residual(&jacobian(&residual, &[0.0; INPUTS]));
        (extra / error, expected)
    }

    #[test]
    fn the_response_of_every_kind_of_input_is_that_of_the_running_features() {
        for place in [0, 6, PAST_COMMANDS.start + 2, LEAKY.start, LEAKY.start + 3, INTEGRAL] {
            for hz in [1.0, 5.0, 20.0] {
                let (found, expected) = simulated(place, hz);
                assert!(
                    (found - expected).norm() < 0.03 * expected.norm(),
                    "{place} {hz}: {found:?} {expected:?}"
                );
            }
        }
    }

    #[test]
    fn the_larger_gain_is_kept_with_its_place() {
        let at = |value| Largest { value, hz: value, pip: value as f32 };
        let gain = |direct, residual, times| ResidualGain {
            direct: at(direct),
            residual: at(residual),
            times_loop: at(times),
        };
        assert_eq!(gain(1.0, 4.0, 7.0).worst(&gain(2.0, 3.0, 6.0)), gain(2.0, 4.0, 7.0));
        assert_eq!(gain(1.0, 4.0, 6.0).worst(&gain(1.0, 5.0, 7.0)), gain(1.0, 5.0, 7.0));
    }
}
