//! What is held out of a fit altogether: a lung by its nominal values, or a lung or test run by its name.

use std::convert::Infallible;
use std::fmt;
use std::str::FromStr;

use crate::simulator::episode::Episode;
use data::identity::{LungParameters, TestRun};

/// A lung or a test run that no breath of the fit may come from.
#[derive(Clone, Debug, PartialEq)]
pub enum HeldOut {
    /// Every lung with these nominal values.
    Lung(LungParameters),
    /// The group of the recording with this name.
    Group(String),
}

impl HeldOut {
    /// Whether it is the lung of an episode of a recording with these groups.
    pub(super) fn has(&self, episode: &Episode, groups: &[TestRun]) -> bool {
        let group = || groups.get(episode.group? as usize).map(TestRun::to_string);
        match self {
            Self::Lung(lung) => episode.lung == Some(*lung),
            Self::Group(name) => group().is_some_and(|group| group == *name),
        }
    }
}

impl FromStr for HeldOut {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(text.parse().map_or_else(|_| Self::Group(text.to_owned()), Self::Lung))
    }
}

impl fmt::Display for HeldOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lung(lung) => write!(f, "{lung} (R:C)"),
            Self::Group(name) => f.write_str(name),
        }
    }
}
