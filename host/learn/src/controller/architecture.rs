//! The seam between training and the architectures of a controller.
//!
//! Each architecture adds a network's output, scaled by lambda and limited to its authority, to a PID. They differ in the
//! network and in its inputs, which is all that these traits hold: [`Trainable`] for the controller, [`LanePart`] for the
//! learned part over lanes.

use std::fmt::Debug;

use engine::Lane;
use rand_chacha::ChaCha8Rng;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use shared::control::ControlLaw;
use shared::control::pid::Pid;
use shared::control::residual::{Residual, ResidualError, ResidualSpec};

use super::scenario::Scenario;
use super::signals::Signals;

/// The architectures of the learned part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControllerArchitecture {
    /// Ours: [`shared::control::network`] on [`shared::control::features`], which a chip runs.
    #[default]
    Ours,
    /// That of the paper's authors: a convolution over running averages of the last ten errors (see [`super::authors`]).
    Authors {
        /// Time between two of the ten errors, microseconds.
        error_spacing_us: u32,
    },
}

/// Time between two errors of the authors' controller by default, microseconds: of 2, 5, 10, 20 and 30 ms, the one with the lowest
/// error on the held-out simulator of R20C20 (RESULTS.md, "The authors' network").
const ERROR_SPACING_US: u32 = 10_000;

impl ControllerArchitecture {
    /// The authors' architecture with the default time between two errors, for a control period in microseconds.
    pub fn authors(period_us: u32) -> Self {
        Self::Authors { error_spacing_us: ERROR_SPACING_US.max(period_us) }
    }

    /// Whether it is ours.
    pub fn is_ours(&self) -> bool {
        *self == Self::Ours
    }

    /// Name on the command line and in files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Ours => "ours",
            Self::Authors { .. } => "authors",
        }
    }
}

/// A controller that can be trained: a PID plus a residual computed by a network.
pub trait Trainable: Clone + Debug + PartialEq + Send + Sync {
    /// The learned part over lanes.
    type Lanes: LanePart;
    /// The control law that runs it, or a PID in its place.
    type Law: ControlLaw + Clone + Send + Sync + 'static;
    /// Everything except the network's parameters, as in files.
    type Spec: Copy + Debug + PartialEq + Serialize + DeserializeOwned;

    /// The name in files; none for ours, which is older than the name.
    const NAME: Option<&'static str>;

    /// The controller of a specification and parameters.
    ///
    /// # Errors
    /// A value out of bounds.
    ///
    /// # Panics
    /// If the number of parameters is not [`Self::size`].
    fn build(spec: Self::Spec, parameters: &[f32]) -> Result<Self, ResidualError>;

    /// The specification of this architecture around the fixed parts of a residual; none if another architecture is asked
    /// for.
    fn specify(residual: ResidualSpec, architecture: ControllerArchitecture) -> Option<Self::Spec>;

    /// The specification.
    fn specification(&self) -> Self::Spec;

    /// The parameters of the network.
    fn parameters(&self) -> Vec<f32>;

    /// Number of parameters.
    fn size() -> usize;

    /// Parameters to start training from; the output layer is zero, so that the controller starts as its PID.
    fn initial_parameters(rng: &mut ChaCha8Rng) -> Vec<f32>;

    /// Zeroes the weights of features, by their index, in parameters or a gradient.
    ///
    /// # Panics
    /// If a feature does not exist.
    fn blind_to(features: &[usize], parameters: &mut [f32]);

    /// PID, lambda, authority and control period.
    fn fixed_parts(&self) -> &Residual;

    /// The learned part with these parameters.
    fn lanes(&self, parameters: &[f32]) -> Self::Lanes;

    /// The law that runs this controller.
    fn law(&self) -> Self::Law;

    /// A PID as such a law.
    ///
    /// # Errors
    /// A period out of bounds.
    fn pid_law(pid: Pid, period_us: u32) -> Result<Self::Law, ResidualError>;
}

/// The learned part of a controller over lanes: from errors and commands to the network's output, forward and backward.
pub trait LanePart: Clone + Debug + Send + Sync {
    /// Values of the forward pass that the backward pass needs, and the gradient so far.
    type Tape: Debug + Send + Sync;
    /// What is carried from tick to tick; in the backward pass, the gradients with respect to it.
    type Carried<'a>
    where
        Self: 'a;

    /// Memory for breaths of `ticks` ticks.
    fn tape(ticks: usize) -> Self::Tape;

    /// Starts the forward pass of a breath.
    fn start<'a>(&'a self, scenario: &'a Scenario) -> Self::Carried<'a>;

    /// Starts the backward pass of a breath.
    fn start_back<'a>(&'a self, scenario: &'a Scenario, tape: &mut Self::Tape) -> Self::Carried<'a>;

    /// The network's output at a tick, from the signals up to this tick's error and the PID's integral (percent).
    fn forward(
        &self,
        scenario: &Scenario,
        tape: &mut Self::Tape,
        carried: &mut Self::Carried<'_>,
        seen: (&Signals, &Lane),
        tick: usize,
    ) -> Lane;

    /// Records the command applied in the tick, percent.
    fn applied(&self, carried: &mut Self::Carried<'_>, command: &Lane);

    /// Backward pass of [`Self::applied`]: adds the gradient with respect to the command.
    fn applied_back(&self, carried: &mut Self::Carried<'_>, d_command: &mut Lane);

    /// Backward pass of [`Self::forward`] for the gradient with respect to its output: adds the gradients with respect to
    /// signals and integral.
    fn backward(
        &self,
        tape: &mut Self::Tape,
        carried: &mut Self::Carried<'_>,
        d_output: Lane,
        d_seen: (&mut Signals, &mut Lane),
        tick: usize,
    );

    /// Adds the gradient with respect to the parameters over the breath's ticks.
    fn finish(&self, tape: &Self::Tape, gradient: &mut [f32]);
}
