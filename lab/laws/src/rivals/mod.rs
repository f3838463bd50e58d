//! Rivals of the learned controllers: laws from the literature, each tuned in good faith.
//!
//! A PID is only the simplest rival. The rivals are a variable-gain law ([`variable_gain`]),
//! iterative learning over a PID ([`iterative`]) and a PID with a feed-forward from an identified model ([`feed_forward`]). The
//! learned controller with iterative learning ([`gated`]) is compared in the same way. They run in this process only, under the same
//! supervisor and safety filter as the controllers of a device. [`tuning`] searches their parameters; [`Rival`] is the registry of
//! their names.

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

use margins::iteration::LearningFilter;
use ventilator::law::AnyLaw;

use feed_forward::FeedForward;
use gated::Gated;
use iterative::Iterative;
use machine::Machine;
use parameter::{Parameter, RivalError};
use variable_gain::VariableGain;

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
                AnyLaw::new(VariableGain::new(values.try_into().map_err(count)?, period_us)?)
            }
            Self::Iterative => AnyLaw::new(Iterative::new(values.try_into().map_err(count)?, period_us)?),
            Self::FeedForward => {
                AnyLaw::new(FeedForward::new(values.try_into().map_err(count)?, machine, period_us)?)
            }
            Self::Gated => AnyLaw::new(Gated::new(values.try_into().map_err(count)?, period_us)?),
        })
    }
}

/// The learning rule of a law that learns a feed-forward from breath to breath.
pub fn learning(law: &AnyLaw) -> Option<LearningFilter> {
    let iterative = law.downcast().map(Iterative::filter);
    iterative.or_else(|| law.downcast().map(Gated::filter))
}
