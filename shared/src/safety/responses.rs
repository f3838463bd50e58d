//! The responses by which ventilation goes on, each of which can be left out to show that it is needed.

use super::ladder::Level;

/// A response of the ventilator to a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// The PID alone controls.
    Pid,
    /// The compiled-in PID controls, with a capped command.
    CappedPid,
    /// The commands of good breaths are repeated.
    Backup,
    /// The other pressure sensor is used.
    OtherSensor,
    /// PIP rises with a baseline that stays high.
    HigherPip,
    /// A flow holds PEEP against a leak.
    LeakCompensation,
    /// Ventilation resumes after a reset.
    Resume,
    /// Backup ventilation delivers the volume that the flow sensor shows.
    BackupByFlow,
}

impl Response {
    /// All responses.
    pub const ALL: [Self; 8] = [
        Self::Pid,
        Self::CappedPid,
        Self::Backup,
        Self::OtherSensor,
        Self::HigherPip,
        Self::LeakCompensation,
        Self::Resume,
        Self::BackupByFlow,
    ];

    /// Its name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pid => "step to the PID",
            Self::CappedPid => "step to the capped PID",
            Self::Backup => "backup ventilation",
            Self::OtherSensor => "change to the other sensor",
            Self::HigherPip => "PIP that follows the baseline",
            Self::LeakCompensation => "leak compensation",
            Self::Resume => "resume after a reset",
            Self::BackupByFlow => "backup ventilation by flow",
        }
    }
}

/// A set of responses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Responses(u16);

impl Responses {
    /// All responses.
    pub const ALL: Self = Self(u16::MAX);

    /// The same set without one of them.
    #[must_use]
    pub const fn without(self, response: Response) -> Self {
        Self(self.0 & !(1 << response as u16))
    }

    /// Whether a response is in the set.
    pub const fn has(self, response: Response) -> bool {
        self.0 & 1 << response as u16 != 0
    }

    /// The level at which a ladder stands that lacks the missing steps.
    pub fn level(self, level: Level) -> Level {
        match level {
            Level::CappedPid if !self.has(Response::CappedPid) => self.level(Level::Pid),
            Level::Pid if !self.has(Response::Pid) => Level::Learned,
            level => level,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Level::{Backup, CappedPid, Learned, Pid};

    #[test]
    fn a_response_left_out_is_the_only_one_that_is_missing() {
        for left_out in Response::ALL {
            let responses = Responses::ALL.without(left_out);
            assert!(
                Response::ALL.into_iter().all(|response| responses.has(response) == (response != left_out))
            );
        }
    }

    #[test]
    fn a_ladder_without_a_step_stands_on_the_one_above() {
        let levels =
            |responses: Responses| [Learned, Pid, CappedPid, Backup].map(|level| responses.level(level));
        assert_eq!(levels(Responses::ALL), [Learned, Pid, CappedPid, Backup]);
        assert_eq!(levels(Responses::ALL.without(Response::CappedPid)), [Learned, Pid, Pid, Backup]);
        assert_eq!(levels(Responses::ALL.without(Response::Pid)), [Learned, Learned, CappedPid, Backup]);
    }

    #[test]
    fn each_response_has_a_name_of_its_own() {
        for (place, response) in Response::ALL.into_iter().enumerate() {
            assert!(!response.name().is_empty());
            assert!(Response::ALL[..place].iter().all(|other| other.name() != response.name()));
        }
    }
}
