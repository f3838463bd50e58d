//! Rivals of the learned controllers: laws from the literature, each tuned in good faith.
//!
//! A PID is only the simplest rival. The rivals are a variable-gain law ([`variable_gain`]),
//! iterative learning over a PID ([`iterative`]) and a PID with a feed-forward from an identified model ([`feed_forward`]). The
//! learned controller with iterative learning ([`gated`]) is compared in the same way. They run in this process only, under the same
//! supervisor and safety filter as the controllers of a device. [`tuning`] searches their parameters; [`Rival`] is the registry of
//! their names, and [`AnyLaw`] runs any of them in the place of a [`Controller`], as well as the controller of the paper's authors,
//! which is trained ([`learn::controller::authors`]), and a third party's policy ([`crate::policy`]).

pub mod feed_forward;
pub mod feed_learning;
pub mod gated;
pub mod iterative;
pub mod lung;
pub mod lung_fit;
pub mod machine;
pub mod parameter;
#[cfg(test)]
mod tests;
pub mod tuning;
pub mod variable_gain;

use shared::control::memory::Lesson;
use shared::control::pid::{Pid, PidState};
use shared::control::{ControlLaw, ControlOutput, Controller, ControllerState, Observation};

use crate::evaluate::{Evaluated, Ground, Plan, SourceGround};
use crate::margins::iteration::LearningFilter;
use crate::policy::{PolicyLaw, PolicyState};
use feed_forward::{FeedForward, FeedForwardState};
use gated::{Gated, GatedState};
use iterative::{Iterative, IterativeState};
use learn::controller::authors::{AuthorsController, AuthorsState};
use machine::Machine;
use parameter::{Parameter, RivalError};
use progress::Progress;
use variable_gain::VariableGain;
use ventilator::SourceError;

/// The rivals by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rival {
    /// PID with a higher gain on large errors.
    VariableGain,
    /// Iterative learning over a PID.
    Iterative,
    /// PID with a feed-forward from an identified model.
    FeedForward,
    /// The learned controller with gated iterative learning.
    Gated,
}

impl Rival {
    /// All rivals.
    pub const ALL: [Self; 4] = [Self::VariableGain, Self::Iterative, Self::FeedForward, Self::Gated];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::VariableGain => "variable-gain",
            Self::Iterative => "iterative",
            Self::FeedForward => "feed-forward",
            Self::Gated => "gated",
        }
    }

    /// The rival with this name, if there is one.
    pub fn find(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|rival| rival.name() == name)
    }

    /// Its parameters, in the order of their values.
    pub fn parameters(self) -> &'static [Parameter] {
        match self {
            Self::VariableGain => &variable_gain::PARAMETERS,
            Self::Iterative => &iterative::PARAMETERS,
            Self::FeedForward => &feed_forward::PARAMETERS,
            Self::Gated => &gated::PARAMETERS,
        }
    }

    /// The values tuned for the family `adult`.
    pub fn tuned(self) -> Vec<f32> {
        self.parameters().iter().map(|parameter| parameter.tuned).collect()
    }

    /// Breaths on each plant in the search for its parameters. Iterative learning goes on for tens of breaths; the lung of the
    /// feed-forward is known after the first few.
    pub fn breaths_tuned(self) -> u32 {
        match self {
            Self::VariableGain => 3,
            Self::FeedForward => 6,
            Self::Iterative | Self::Gated => 20,
        }
    }

    /// The law with these values, one for each parameter, on a machine with these nominal values.
    ///
    /// # Errors
    /// A value out of bounds, a number of values that differs from that of the parameters, or a period for which the learned
    /// controller of [`Self::Gated`] was not trained.
    pub fn law(self, values: &[f32], machine: Machine, period_us: u32) -> Result<AnyLaw, RivalError> {
        let wanted = self.parameters().len();
        let count = |_| RivalError::Count { rival: self.name(), wanted, given: values.len() };
        Ok(match self {
            Self::VariableGain => {
                AnyLaw::VariableGain(VariableGain::new(values.try_into().map_err(count)?, period_us)?)
            }
            Self::Iterative => {
                AnyLaw::Iterative(Iterative::new(values.try_into().map_err(count)?, period_us)?)
            }
            Self::FeedForward => {
                AnyLaw::FeedForward(FeedForward::new(values.try_into().map_err(count)?, machine, period_us)?)
            }
            Self::Gated => AnyLaw::Gated(Gated::new(values.try_into().map_err(count)?, period_us)?),
        })
    }
}

/// A controller of a device, one of the rivals, the trained controller of the paper's authors, or a third party's policy.
#[derive(Clone, Debug, PartialEq)]
pub enum AnyLaw {
    /// A controller that a device can run.
    Chip(Controller),
    /// See [`variable_gain`].
    VariableGain(VariableGain),
    /// See [`iterative`].
    Iterative(Iterative),
    /// See [`feed_forward`].
    FeedForward(FeedForward),
    /// See [`gated`].
    Gated(Gated),
    /// See [`learn::controller::authors`].
    Authors(AuthorsController),
    /// See [`crate::policy`].
    Policy(PolicyLaw),
}

/// States of all laws, of which a law uses its own: a change of the law within a breath is possible.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AnyState {
    chip: ControllerState,
    variable_gain: PidState,
    iterative: IterativeState,
    feed_forward: FeedForwardState,
    gated: GatedState,
    authors: AuthorsState,
    policy: PolicyState,
}

impl AnyLaw {
    /// Its PID: alone, or the one underneath.
    pub fn pid(&self) -> &Pid {
        match self {
            Self::Chip(controller) => controller.pid(),
            Self::VariableGain(law) => law.pid(),
            Self::Iterative(law) => law.pid(),
            Self::FeedForward(law) => law.pid(),
            Self::Gated(law) => law.pid(),
            Self::Authors(law) => law.pid(),
            Self::Policy(law) => law.pid(),
        }
    }

    /// The learning rule, if the law learns a feed-forward from breath to breath.
    pub fn learning(&self) -> Option<LearningFilter> {
        match self {
            Self::Iterative(law) => Some(law.filter()),
            Self::Gated(law) => Some(law.filter()),
            _ => None,
        }
    }

    /// The controller, if a device can run it.
    pub fn chip(&self) -> Option<&Controller> {
        match self {
            Self::Chip(controller) => Some(controller),
            _ => None,
        }
    }
}

impl ControlLaw for AnyLaw {
    type State = AnyState;

    fn initial_state(&self) -> AnyState {
        AnyState::default()
    }

    fn learn(&self, state: &mut AnyState, lesson: Lesson) -> Lesson {
        match self {
            Self::Chip(law) => law.learn(&mut state.chip, lesson),
            Self::VariableGain(law) => law.learn(&mut state.variable_gain, lesson),
            Self::Iterative(law) => law.learn(&mut state.iterative, lesson),
            Self::FeedForward(law) => law.learn(&mut state.feed_forward, lesson),
            Self::Gated(law) => law.learn(&mut state.gated, lesson),
            Self::Authors(law) => law.learn(&mut state.authors, lesson),
            Self::Policy(law) => law.learn(&mut state.policy, lesson),
        }
    }

    fn start_breath(&self, state: &mut AnyState, command: f32) {
        match self {
            Self::Chip(law) => law.start_breath(&mut state.chip, command),
            Self::VariableGain(law) => law.start_breath(&mut state.variable_gain, command),
            Self::Iterative(law) => law.start_breath(&mut state.iterative, command),
            Self::FeedForward(law) => law.start_breath(&mut state.feed_forward, command),
            Self::Gated(law) => law.start_breath(&mut state.gated, command),
            Self::Authors(law) => law.start_breath(&mut state.authors, command),
            Self::Policy(law) => law.start_breath(&mut state.policy, command),
        }
    }

    fn step(&self, state: &mut AnyState, seen: &Observation) -> ControlOutput {
        match self {
            Self::Chip(law) => law.step(&mut state.chip, seen),
            Self::VariableGain(law) => law.step(&mut state.variable_gain, seen),
            Self::Iterative(law) => law.step(&mut state.iterative, seen),
            Self::FeedForward(law) => law.step(&mut state.feed_forward, seen),
            Self::Gated(law) => law.step(&mut state.gated, seen),
            Self::Authors(law) => law.step(&mut state.authors, seen),
            Self::Policy(law) => law.step(&mut state.policy, seen),
        }
    }

    fn applied(&self, state: &mut AnyState, command: f32) {
        match self {
            Self::Chip(law) => law.applied(&mut state.chip, command),
            Self::VariableGain(law) => law.applied(&mut state.variable_gain, command),
            Self::Iterative(law) => law.applied(&mut state.iterative, command),
            Self::FeedForward(law) => law.applied(&mut state.feed_forward, command),
            Self::Gated(law) => law.applied(&mut state.gated, command),
            Self::Authors(law) => law.applied(&mut state.authors, command),
            Self::Policy(law) => law.applied(&mut state.policy, command),
        }
    }
}

/// A device to evaluate on: it runs its own controllers and refuses the rivals.
pub struct DeviceGround(pub SourceGround);

impl Ground<AnyLaw> for DeviceGround {
    fn name(&self) -> String {
        self.0.name()
    }

    fn evaluate(&self, law: &AnyLaw, plan: &Plan, progress: &Progress<'_>) -> Evaluated {
        match law.chip() {
            Some(controller) => self.0.evaluate(controller, plan, progress),
            None => {
                Err(SourceError::Controller("a device runs PIDs and learned controllers only".to_owned()))
            }
        }
    }
}
