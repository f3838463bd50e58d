//! The learned controller: PID plus a network's output scaled by lambda (Suo et al. 2021, section 5).

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::features::{COMMAND_SCALE, FEATURES, FeatureError, FeatureSpec, Features};
use super::memory::{RECALLED, bin_ticks};
use super::network::{INPUTS, Network};
use super::pid::{GainError, Pid, PidGains};
use super::{COMMAND_MAX, ControlOutput, ControllerState, Observation};
use crate::breath::PERIOD_BOUNDS_US;
use crate::math;

/// Specification of a learned controller: everything except the network's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResidualSpec {
    /// Control period for which the controller was trained, microseconds.
    pub period_us: u32,
    /// Gains of the PID underneath.
    pub gains: PidGains,
    /// Scale of the residual, 0 to 1. With 0 the PID controls alone; with 1 a network output of one is 100 percent.
    pub lambda: f32,
    /// Largest magnitude of the residual, percent.
    pub authority: f32,
    /// Inputs of the network.
    pub features: FeatureSpec,
}

impl ResidualSpec {
    /// Builds the PID and the features of an otherwise valid specification.
    pub(crate) fn parts(&self) -> Result<(Pid, Features), ResidualError> {
        self.check_bounds()?;
        Ok((Pid::new(self.gains, self.period_us)?, Features::new(self.features, self.period_us)?))
    }

    /// Checks lambda, authority and period.
    fn check_bounds(&self) -> Result<(), ResidualError> {
        for (name, value, max) in [("lambda", self.lambda, 1.0), ("authority", self.authority, COMMAND_MAX)] {
            if !(value >= 0.0 && value <= max) {
                return Err(ResidualError::OutOfBounds { name, value, max });
            }
        }
        if self.period_us < PERIOD_BOUNDS_US.0 || self.period_us > PERIOD_BOUNDS_US.1 {
            return Err(ResidualError::Period(self.period_us));
        }
        Ok(())
    }
}

/// Reason why a learned controller cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ResidualError {
    /// A gain of the PID is out of bounds.
    #[error(transparent)]
    Gain(#[from] GainError),
    /// The features are unusable.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// Lambda or the authority is out of bounds.
    #[error("{name} is {value}, allowed are 0 to {max}")]
    OutOfBounds {
        /// `lambda` or `authority`.
        name: &'static str,
        /// Requested value.
        value: f32,
        /// Largest accepted value.
        max: f32,
    },
    /// The control period is out of bounds.
    #[error("control period of {0} us is outside {min} to {max} us", min = PERIOD_BOUNDS_US.0, max = PERIOD_BOUNDS_US.1)]
    Period(u32),
    /// A parameter of the network is not a number or out of bounds.
    #[error("a weight of the network is not finite or out of bounds; train or transfer the controller again")]
    Weights,
}

/// A learned controller, ready to run.
#[derive(Clone, Debug, PartialEq)]
pub struct Residual {
    spec: ResidualSpec,
    pid: Pid,
    features: Features,
    network: Network,
}

impl Residual {
    /// Builds a learned controller.
    ///
    /// # Errors
    /// The first value of `spec` or `network` that is out of bounds.
    pub fn new(spec: ResidualSpec, network: Network) -> Result<Self, ResidualError> {
        spec.check_bounds()?;
        if !network.is_bounded() {
            return Err(ResidualError::Weights);
        }
        let (pid, features) = spec.parts()?;
        Ok(Self { spec, pid, features, network })
    }

    /// Like [`Self::new`] of these [`ResidualSpec::parts`], with a network whose output is zero and whose parameters are then read in
    /// place: each copy of a network takes kilobytes of the chip's stack. Not inlined: it is built in the caller's place.
    #[inline(never)]
    pub(crate) fn zero(spec: ResidualSpec, (pid, features): (Pid, Features)) -> Self {
        Self { spec, pid, features, network: Network::zero() }
    }

    /// The parameters of the network. The caller keeps them bounded.
    pub(crate) fn parameters_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.network.parameters_mut()
    }

    /// Specification from which the controller was built.
    pub fn spec(&self) -> &ResidualSpec {
        &self.spec
    }

    /// The PID underneath.
    pub fn pid(&self) -> &Pid {
        &self.pid
    }

    /// The features that the network sees.
    pub fn features(&self) -> &Features {
        &self.features
    }

    /// The network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Records this tick's observation and returns the network's inputs: the features, then what earlier breaths have taught.
    #[inline]
    pub fn inputs(&self, state: &mut ControllerState, seen: &Observation) -> [f32; INPUTS] {
        let features = self.features.step(&mut state.features, seen, state.pid.integral);
        let recalled = state.memory.recall(seen.tick, bin_ticks(self.spec.period_us));
        with_recalled(&features, &recalled)
    }

    /// Computes the command of one tick.
    pub fn step(&self, state: &mut ControllerState, seen: &Observation) -> ControlOutput {
        let inputs = self.inputs(state, seen);
        let residual = self.correction(self.network.forward(&inputs));
        self.pid.step(&mut state.pid, seen, residual)
    }

    /// Records the command applied in the tick, percent, and ends the tick.
    pub fn applied(&self, state: &mut ControllerState, command: f32) {
        let error = state.features.error();
        self.features.applied(&mut state.features, command);
        state.memory.record(bin_ticks(self.spec.period_us), error, command / COMMAND_SCALE);
    }

    /// Converts a network output to a residual in percent: scaled by lambda, limited to the authority.
    pub fn correction(&self, output: f32) -> f32 {
        let residual =
            math::limit(self.spec.lambda * COMMAND_MAX * output, -self.spec.authority, self.spec.authority);
        debug_assert!(residual.abs() <= self.spec.authority);
        residual
    }
}

/// The inputs of the network from features and what earlier breaths have taught.
#[inline]
pub fn with_recalled(features: &[f32; FEATURES], recalled: &[f32; RECALLED]) -> [f32; INPUTS] {
    let mut inputs = [0.0; INPUTS];
    inputs[..FEATURES].copy_from_slice(features);
    inputs[FEATURES..].copy_from_slice(recalled);
    inputs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::DEFAULT_PERIOD_US;
    use crate::control::memory::Lesson;
    use crate::control::{ControlLaw, Controller};

    fn spec(lambda: f32) -> ResidualSpec {
        ResidualSpec {
            period_us: DEFAULT_PERIOD_US,
            gains: PidGains { p: 2.0, i: 20.0, d: 0.0 },
            lambda,
            authority: 40.0,
            features: FeatureSpec::default(),
        }
    }

    fn constant(output: f32) -> Network {
        let mut network = Network::zero();
        network.output.bias[0] = output;
        network
    }

    fn run(controller: &Controller, ticks: u32) -> f32 {
        let mut state = ControllerState::new();
        controller.start_breath(&mut state, 5.0);
        let mut command = 0.0;
        for tick in 0..ticks {
            let seen =
                Observation { pressure: 12.0, target: 20.0, pip: 20.0, peep: 5.0, tick, rise_ticks: 0 };
            command = controller.step(&mut state, &seen).command;
            controller.applied(&mut state, command);
        }
        command
    }

    #[test]
    fn lambda_zero_is_the_pid_alone() {
        let residual = Residual::new(spec(0.0), constant(0.7)).unwrap();
        let pid = Controller::Pid(*residual.pid());
        assert!((run(&Controller::Residual(residual), 200) - run(&pid, 200)).abs() < 1e-6);
    }

    #[test]
    fn lambda_scales_the_network() {
        let at = |lambda| run(&Controller::Residual(Residual::new(spec(lambda), constant(0.2)).unwrap()), 1);
        assert!((at(0.5) - at(0.0) - 10.0).abs() < 1e-4);
        assert!((at(1.0) - at(0.0) - 20.0).abs() < 1e-4);
    }

    /// Runs and adopts a breath.
    fn breathe(controller: &Controller, state: &mut ControllerState) {
        controller.start_breath(state, 5.0);
        for tick in 0..1000 {
            let seen =
                Observation { pressure: 12.0, target: 20.0, pip: 20.0, peep: 5.0, tick, rise_ticks: 0 };
            let command = controller.step(state, &seen).command;
            controller.applied(state, command);
        }
        controller.learn(state, Lesson::Adopt);
    }

    #[test]
    fn the_network_sees_what_the_breath_before_has_taught_until_a_pid_breathes() {
        let residual = Residual::new(spec(1.0), constant(0.1)).unwrap();
        let (learned, pid) = (Controller::Residual(residual.clone()), Controller::Pid(*residual.pid()));
        let mut state = ControllerState::new();
        let seen =
            Observation { pressure: 12.0, target: 20.0, pip: 20.0, peep: 5.0, tick: 500, rise_ticks: 0 };
        let mut recalls = |controller: &Controller| {
            breathe(controller, &mut state);
            let inputs = residual.inputs(&mut state.clone(), &seen);
            [inputs[FEATURES], inputs[INPUTS - 1]].map(|value| (100.0 * value).round() as i32)
        };
        // An error of 8 cmH2O, and the flag.
        assert_eq!(recalls(&learned), [80, 100]);
        assert_eq!(recalls(&pid), [0, 0]);
        assert_eq!(recalls(&learned), [80, 100]);
    }

    #[test]
    fn the_residual_cannot_exceed_its_authority() {
        let residual = Residual::new(spec(1.0), constant(900.0)).unwrap();
        assert!((residual.correction(900.0) - 40.0).abs() < 1e-6);
        assert!((residual.correction(-900.0) + 40.0).abs() < 1e-6);
        assert!((residual.correction(f32::NAN) + 40.0).abs() < 1e-6, "a NaN can only close the valve");
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        let too_much = Residual::new(spec(1.5), Network::zero());
        assert!(matches!(too_much, Err(ResidualError::OutOfBounds { name: "lambda", .. })));
        assert_eq!(Residual::new(spec(1.0), constant(f32::NAN)), Err(ResidualError::Weights));
        let stopped = ResidualSpec { period_us: 0, ..spec(1.0) };
        assert_eq!(Residual::new(stopped, Network::zero()), Err(ResidualError::Period(0)));
        let period = |period_us| ResidualSpec { period_us, ..spec(1.0) }.check_bounds();
        assert_eq!([250, 50_000].map(period), [Ok(()); 2]);
        assert_eq!([249, 50_001].map(period), [249, 50_001].map(|us| Err(ResidualError::Period(us))));
    }
}
