//! Commands called from another program, such as Python: the outcome as JSON in place of tables, and progress to the caller.
//!
//! Every call has a request to stop and an observer of its own, so any number of them can run at the same time.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::anyhow;
use clap::{Arg, ArgAction};

use super::bounds::stated;
use super::out_file;
use super::program::{line, message, run};
use super::{FAILURE, Failure, Observer, Program};

/// Why a command has no result.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The arguments are wrong.
    #[error("{0}")]
    Usage(String),
    /// The command failed.
    #[error("{}", message(.0))]
    Failed(anyhow::Error),
    /// The command was asked to stop before it had a result.
    #[error("stopped before there was a result")]
    Stopped,
}

/// Runs a command with the arguments that the command line takes, its name first; returns the content of `--json`. A command that is
/// stopped returns the result so far.
///
/// # Errors
/// See [`CallError`].
pub fn call<P: Program>(
    arguments: &[OsString],
    observer: &Observer<'_>,
    stop: &AtomicBool,
) -> Result<String, CallError> {
    let name = OsString::from(P::NAME);
    let all: Vec<_> = std::iter::once(name).chain(arguments.iter().cloned()).collect();
    let line = line::<P>(&all);
    let matches = P::command().try_get_matches_from(all).map_err(|error| usage(&error))?;
    let program = P::from_arg_matches(&matches).map_err(|error| usage(&error))?;
    out_file::check(&P::command(), &matches).map_err(|error| CallError::Usage(message(&error)))?;
    let done = run(&program, &matches, &line, stop, Some(observer));
    match done.failure {
        Some(Failure { status: FAILURE, .. }) if stop.load(Ordering::Relaxed) => Err(CallError::Stopped),
        Some(Failure { error, status: FAILURE }) => Err(CallError::Failed(error)),
        _ => done.json.ok_or_else(|| CallError::Failed(anyhow!("the command has no result as JSON"))),
    }
}

/// The help of a command, as the command line prints it; none if there is no such command.
pub fn help<P: Program>(command: &str) -> Option<String> {
    let mut program = stated(P::command());
    program.build();
    Some(program.find_subcommand_mut(command)?.render_long_help().to_string())
}

/// The long options of a command, each with whether it is repeated for several values, which otherwise are one value with commas;
/// none if there is no such command.
pub fn options<P: Program>(command: &str) -> Option<BTreeMap<String, bool>> {
    let program = P::command();
    let own = program.find_subcommand(command)?.get_arguments();
    let arguments = own.chain(program.get_arguments().filter(|argument| argument.is_global_set()));
    let repeated = |argument: &Arg| {
        matches!(argument.get_action(), ArgAction::Append) && argument.get_value_delimiter().is_none()
    };
    Some(arguments.filter_map(|option| Some((option.get_long()?.to_owned(), repeated(option)))).collect())
}

/// The error without its prefix and the usage lines, which name the command line.
fn usage(error: &clap::Error) -> CallError {
    let text = error.to_string();
    let text = text.split("\n\nUsage:").next().unwrap_or(&text);
    CallError::Usage(text.trim_start_matches("error: ").trim().to_owned())
}
