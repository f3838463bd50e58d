//! The controller of the paper's authors, as a residual (Suo et al. 2021, section 5, and the constants of their code).
//!
//! It sees only the last ten errors: their running averages ([`mod@averages`]) pass a convolution, a rectifier and a dense output
//! ([`convolution`]). As with our network, the output is scaled by lambda, limited to the authority and added to a PID, and the
//! same supervisor and safety filter follow. The law runs on the host only: no weights image holds such a network.
//!
//! The authors take an error at every tick of 30 ms. Here the time between two of the ten errors is a parameter, because the same
//! time at a period of 1 ms need not be the best; errors are scaled like our features, and their output layer starts at zero, so
//! that a training starts from the PID.

pub mod averages;
pub mod convolution;

use engine::Lane;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use shared::control::features::{ERROR_SCALE, FeatureSpec};
use shared::control::network::{Network, WEIGHT_MAX};
use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::residual::{Residual, ResidualError, ResidualSpec};
use shared::control::{ControlLaw, ControlOutput, Observation};

use super::architecture::{ControllerArchitecture, LanePart, Trainable};
use super::scenario::Scenario;
use super::signals::Signals;
use averages::{ERRORS, averages};
use convolution::{Convolution, ConvolutionTape, PARAMETERS, initial_parameters, output};
use ventilator::law::Law;

/// Longest time between two errors, microseconds.
pub const ERROR_SPACING_MAX_US: u32 = 100_000;

/// Time between two of the ten errors in control ticks: the nearest whole number, at least one. Both times in microseconds.
///
/// # Panics
/// If the control period is zero.
pub fn spacing_ticks(error_spacing_us: u32, period_us: u32) -> usize {
    (error_spacing_us.saturating_add(period_us / 2) / period_us).max(1) as usize
}

/// Specification of the authors' controller: everything except the network's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AuthorsSpec {
    /// Control period for which the controller was trained, microseconds.
    pub period_us: u32,
    /// Gains of the PID underneath.
    pub gains: PidGains,
    /// Scale of the residual, 0 to 1.
    pub lambda: f32,
    /// Largest magnitude of the residual, percent.
    pub authority: f32,
    /// Time between two of the ten errors, microseconds; rounded to whole ticks, at least one.
    pub error_spacing_us: u32,
}

/// The authors' controller, ready to run.
#[derive(Clone, Debug, PartialEq)]
pub struct AuthorsController {
    spec: AuthorsSpec,
    /// PID, lambda and authority; its own network is zero.
    fixed: Residual,
    /// Time between two errors, ticks.
    spacing: usize,
    parameters: Vec<f32>,
}

impl AuthorsController {
    /// Builds a controller.
    ///
    /// # Errors
    /// A value out of bounds.
    ///
    /// # Panics
    /// If the number of parameters differs from that of the network.
    pub fn new(spec: AuthorsSpec, parameters: &[f32]) -> Result<Self, ResidualError> {
        assert_eq!(parameters.len(), PARAMETERS, "parameters of another shape");
        let AuthorsSpec { period_us, gains, lambda, authority, error_spacing_us } = spec;
        if error_spacing_us > ERROR_SPACING_MAX_US {
            let (value, max) = (error_spacing_us as f32, ERROR_SPACING_MAX_US as f32);
            return Err(ResidualError::OutOfBounds { name: "time between errors in us", value, max });
        }
        let features = FeatureSpec::for_period(period_us);
        let fixed =
            Residual::new(ResidualSpec { period_us, gains, lambda, authority, features }, Network::zero())?;
        if !parameters.iter().all(|weight| weight.abs() <= WEIGHT_MAX) {
            return Err(ResidualError::Weights);
        }
        let spacing = spacing_ticks(error_spacing_us, period_us);
        Ok(Self { spec, fixed, spacing, parameters: parameters.to_vec() })
    }

    /// Time between two of the ten errors, ticks.
    pub fn spacing(&self) -> usize {
        self.spacing
    }

    /// Specification from which the controller was built.
    pub fn spec(&self) -> &AuthorsSpec {
        &self.spec
    }
}

/// State of the authors' controller.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AuthorsState {
    pid: PidState,
    /// Scaled errors of the breath, tick by tick.
    errors: Vec<f32>,
}

impl Law for AuthorsController {
    fn pid(&self) -> &Pid {
        self.fixed.pid()
    }
}

impl ControlLaw for AuthorsController {
    type State = AuthorsState;

    fn initial_state(&self) -> AuthorsState {
        AuthorsState::default()
    }

    fn start_breath(&self, state: &mut AuthorsState, _command: f32) {
        state.pid = PidState::new();
        state.errors.clear();
    }

    fn step(&self, state: &mut AuthorsState, seen: &Observation) -> ControlOutput {
        state.errors.push((seen.target - seen.pressure) / ERROR_SCALE);
        let past = |count: usize| state.errors.iter().rev().nth(count * self.spacing);
        let newest_first: [f32; ERRORS] = std::array::from_fn(|count| past(count).copied().unwrap_or(0.0));
        let residual = self.fixed.correction(output(&self.parameters, &averages(&newest_first)));
        self.pid().step(&mut state.pid, seen, residual)
    }

    fn applied(&self, _state: &mut AuthorsState, _command: f32) {}
}

impl Trainable for AuthorsController {
    type Lanes = AuthorsLanes;
    type Law = Self;
    type Spec = AuthorsSpec;

    const NAME: Option<&'static str> = Some("authors");

    fn build(spec: AuthorsSpec, parameters: &[f32]) -> Result<Self, ResidualError> {
        Self::new(spec, parameters)
    }

    fn specify(residual: ResidualSpec, architecture: ControllerArchitecture) -> Option<AuthorsSpec> {
        let ControllerArchitecture::Authors { error_spacing_us } = architecture else { return None };
        let ResidualSpec { period_us, gains, lambda, authority, .. } = residual;
        Some(AuthorsSpec { period_us, gains, lambda, authority, error_spacing_us })
    }

    fn specification(&self) -> AuthorsSpec {
        self.spec
    }

    fn parameters(&self) -> Vec<f32> {
        self.parameters.clone()
    }

    fn size() -> usize {
        PARAMETERS
    }

    fn initial_parameters(rng: &mut ChaCha8Rng) -> Vec<f32> {
        initial_parameters(rng)
    }

    fn blind_to(features: &[usize], _parameters: &mut [f32]) {
        assert!(features.is_empty(), "the authors' network has no such feature");
    }

    fn fixed_parts(&self) -> &Residual {
        &self.fixed
    }

    fn lanes(&self, parameters: &[f32]) -> AuthorsLanes {
        AuthorsLanes { spacing: self.spacing, network: Convolution::new(parameters) }
    }

    fn law(&self) -> Self {
        self.clone()
    }

    /// A controller whose network is zero.
    fn pid_law(pid: Pid, period_us: u32) -> Result<Self, ResidualError> {
        let spec =
            AuthorsSpec { period_us, gains: pid.gains(), lambda: 0.0, authority: 0.0, error_spacing_us: 0 };
        Self::new(spec, &[0.0; PARAMETERS])
    }
}

/// Averages and network over lanes.
#[derive(Clone, Debug)]
pub struct AuthorsLanes {
    spacing: usize,
    network: Convolution,
}

impl LanePart for AuthorsLanes {
    type Tape = ConvolutionTape;
    type Carried<'a> = ();

    fn tape(ticks: usize) -> ConvolutionTape {
        ConvolutionTape::new(ticks)
    }

    fn start<'a>(&'a self, _scenario: &'a Scenario) {}

    fn start_back<'a>(&'a self, _scenario: &'a Scenario, tape: &mut ConvolutionTape) {
        tape.start_back();
    }

    fn forward(
        &self,
        _scenario: &Scenario,
        tape: &mut ConvolutionTape,
        (): &mut (),
        (signals, _integral): (&Signals, &Lane),
        tick: usize,
    ) -> Lane {
        averages::forward(&signals.error, tick, self.spacing, tape.inputs(tick));
        self.network.forward(tape, tick)
    }

    fn applied(&self, (): &mut (), _command: &Lane) {}

    fn applied_back(&self, (): &mut (), _d_command: &mut Lane) {}

    fn backward(
        &self,
        tape: &mut ConvolutionTape,
        (): &mut (),
        d_output: Lane,
        (d_signals, _d_integral): (&mut Signals, &mut Lane),
        tick: usize,
    ) {
        let d_averages = self.network.backward(tape, tick, d_output);
        averages::backward(d_averages, tick, self.spacing, &mut d_signals.error);
    }

    fn finish(&self, tape: &ConvolutionTape, gradient: &mut [f32]) {
        Convolution::finish(tape, gradient);
    }
}

#[cfg(test)]
mod tests;
