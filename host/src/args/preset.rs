//! Named sets of settings.

/// A named set of third-party settings; options on the command line take precedence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Preset {
    /// The paper's authors: 30 ms, PEEP 5 cmH2O, their exploration, PID and simulator
    #[value(name = "paper-30ms")]
    Paper30Ms,
}
