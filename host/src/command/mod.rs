//! The frame of a command line: what a command is, what it runs in, and the record of its run. It knows no command.
//!
//! A program lists its commands with [`commands!`](crate::commands) and is a [`Program`]; [`main`] runs it as a process, [`call`]
//! runs one of its commands for another program. Nothing here belongs to the process as a whole, so commands can run side by side.

mod bars;
pub mod bounds;
pub mod call;
pub mod completions;
mod context;
mod help;
mod out_file;
mod output;
mod program;
mod record;

use serde::Serialize;

pub use campaign::shell::quoted;
pub use context::{Context, Observer};
pub use out_file::{ForceArgs, OutFile};
pub use output::{Makes, Output, OutputArgs, write, write_json};
pub use program::{Done, Failure, Program, Runnable, main};

/// Exit status of a command that failed.
pub const FAILURE: u8 = 1;

/// A command; the value holds its arguments.
pub trait Command {
    /// What it computes: the content of `--json`, which a program that calls it gets as well.
    type Outcome: Serialize;

    /// Exit status if [`Self::conclude`] fails. With a status of its own, that failure is part of the outcome, which a program that
    /// called the command then gets in place of an error.
    const REFUSED: u8 = FAILURE;

    /// Where its outcome goes.
    fn output(&self) -> Output<'_> {
        Output::default()
    }

    /// Runs the command. None if there is nothing to return, as after a shard. A command that is stopped returns what it has.
    ///
    /// # Errors
    /// Whatever kept it from an outcome.
    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Self::Outcome>>;

    /// Does what must wait until the outcome is saved, such as judging it.
    ///
    /// # Errors
    /// The outcome is not what the command must reach; it stays saved.
    fn conclude(&self, _outcome: Self::Outcome, _context: &Context<'_>) -> anyhow::Result<()> {
        Ok(())
    }
}

/// Declares the commands of a program as a subcommand of clap, one command a line, in the groups in which the help lists them.
#[macro_export]
macro_rules! commands {
    (
        $(#[$attribute:meta])*
        $visibility:vis enum $commands:ident {
            $($group:literal { $($(#[$condition:meta])* $name:ident($arguments:ty),)* })*
        }
    ) => {
        $(#[$attribute])*
        #[derive(Debug, clap::Subcommand)]
        $visibility enum $commands { $($($(#[$condition])* $name($arguments),)*)* }

        impl $commands {
            /// The group of each command, in their order.
            const GROUPS: &'static [&'static str] = &[$($($(#[$condition])* $group,)*)*];

            fn chosen(&self) -> &dyn $crate::command::Runnable {
                match self { $($($(#[$condition])* Self::$name(arguments) => arguments,)*)* }
            }
        }
    };
}
