//! Settings of others under one name.

use clap::ValueEnum;

use data::recording::Recording;
use learn::pipeline::{PAPER_PEEP, PAPER_PERIOD_US};

/// Whose setting; what is typed beside it has precedence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Preset {
    /// The paper's authors: 30 ms, PEEP 5 cmH2O, their exploration, PID and simulator
    #[value(name = "paper-30ms")]
    Paper30Ms,
}

impl Preset {
    /// Whether a recording was made in this setting.
    ///
    /// # Errors
    /// What differs.
    pub fn check(self, recording: &Recording) -> anyhow::Result<()> {
        let Self::Paper30Ms = self;
        let period_us = recording.provenance.period_us;
        if period_us != PAPER_PERIOD_US {
            anyhow::bail!(
                "the recording's control period is {period_us} us, that of paper-30ms {PAPER_PERIOD_US}: \
                 collect one with --period-us {PAPER_PERIOD_US}, or leave --preset out"
            );
        }
        if let Some(peep) = recording.peep.iter().find(|peep| (**peep - PAPER_PEEP).abs() > f32::EPSILON) {
            anyhow::bail!("the recording has breaths at PEEP {peep} cmH2O, paper-30ms has {PAPER_PEEP}");
        }
        Ok(())
    }
}
