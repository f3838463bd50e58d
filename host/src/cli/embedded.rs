//! Commands called from another program, such as Python: results as JSON in place of tables, and progress to the caller.
//!
//! One command runs at a time, because the request to stop and the record of a run belong to the process: a [`Session`] holds that
//! place, and a second one is refused.

use std::ffi::OsString;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::anyhow;
use clap::{CommandFactory, FromArgMatches};
use serde::Serialize;

use super::{Cli, bars, common, dispatch, judge, made_by, message};
use progress::Event;

/// Receives the progress of a command, on any thread.
pub type Observer = Arc<dyn Fn(&Event<'_>) + Send + Sync>;

/// Why a command has no result.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The arguments are wrong.
    #[error("{0}")]
    Usage(String),
    /// Another command is running.
    #[error("another command is running in this process: wait for it, or use another process")]
    Busy,
    /// The command failed.
    #[error("{}", message(.0))]
    Failed(anyhow::Error),
    /// The command was asked to stop before it had a result.
    #[error("stopped before there was a result")]
    Stopped,
}

/// A call in progress.
struct Call {
    observer: Observer,
    /// The JSON of the command, once it is known.
    result: Option<String>,
}

/// Whether there is a session.
static BUSY: AtomicBool = AtomicBool::new(false);
/// The running call; none if the process is the command line itself.
static CALL: Mutex<Option<Call>> = Mutex::new(None);

fn with_call<T>(use_it: impl FnOnce(&mut Option<Call>) -> T) -> T {
    use_it(&mut CALL.lock().unwrap_or_else(PoisonError::into_inner))
}

/// The place of the one command that may run.
#[derive(Debug)]
pub struct Session(());

impl Session {
    /// Takes the place. A request to stop counts from here on.
    ///
    /// # Errors
    /// [`CallError::Busy`].
    pub fn begin() -> Result<Self, CallError> {
        if BUSY.swap(true, Ordering::SeqCst) {
            return Err(CallError::Busy);
        }
        common::stop().store(false, Ordering::SeqCst);
        Ok(Self(()))
    }

    /// Runs a command with the arguments that the command line takes, its name first; returns the content of `--json`. A command that
    /// was asked to stop returns the result so far.
    ///
    /// # Errors
    /// See [`CallError`].
    pub fn run(self, arguments: &[OsString], observer: Observer) -> Result<String, CallError> {
        let line = std::iter::once(OsString::from("trainer")).chain(arguments.iter().cloned());
        let matches = Cli::command().try_get_matches_from(line).map_err(|error| usage(&error))?;
        let cli = Cli::from_arg_matches(&matches).map_err(|error| usage(&error))?;
        with_call(|call| *call = Some(Call { observer, result: None }));
        let outcome = made_by::recorded(&Cli::command(), &matches, || dispatch(&cli.command));
        let result = with_call(Option::take).and_then(|call| call.result);
        match outcome {
            Err(error) if !error.is::<judge::Violated>() => {
                Err(if common::stopped() { CallError::Stopped } else { CallError::Failed(error) })
            }
            _ => result.ok_or_else(|| CallError::Failed(anyhow!("the command has no result as JSON"))),
        }
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        with_call(|call| *call = None);
        BUSY.store(false, Ordering::SeqCst);
    }
}

/// Asks the running command to stop; it keeps its results so far.
pub fn request_stop() {
    common::stop().store(true, Ordering::SeqCst);
}

/// The help of a command, as the command line prints it; none if there is no such command.
pub fn help(command: &str) -> Option<String> {
    let mut cli = Cli::command();
    cli.build();
    Some(cli.find_subcommand_mut(command)?.render_long_help().to_string())
}

/// The long options of a command; none if there is no such command.
pub fn options(command: &str) -> Option<Vec<String>> {
    let cli = Cli::command();
    let arguments = cli.find_subcommand(command)?.get_arguments();
    Some(arguments.filter_map(|argument| argument.get_long().map(str::to_owned)).collect())
}

/// The stage of an event in words, with its subject and round.
pub fn stage(event: &Event<'_>) -> String {
    bars::name(event)
}

/// The error without its prefix and the usage lines, which name the command line.
fn usage(error: &clap::Error) -> CallError {
    let text = error.to_string();
    let text = text.split("\n\nUsage:").next().unwrap_or(&text);
    CallError::Usage(text.trim_start_matches("error: ").trim().to_owned())
}

/// Whether a call is running, so that nothing may be printed.
pub(super) fn is_called() -> bool {
    with_call(|call| call.is_some())
}

/// Keeps the result of the running call, if there is one. As text: a value would widen numbers of 32 bits, and so show other digits
/// than the command line.
pub(super) fn keep(results: &impl Serialize) -> anyhow::Result<()> {
    if is_called() {
        let text = serde_json::to_string(results)?;
        with_call(|call| call.as_mut().map(|call| call.result = Some(text)));
    }
    Ok(())
}

/// The observer of the running call, if there is one.
pub(super) fn observer() -> Option<Observer> {
    with_call(|call| call.as_ref().map(|call| call.observer.clone()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn called(line: &str) -> Result<Value, CallError> {
        let arguments: Vec<OsString> = line.split(' ').map(OsString::from).collect();
        // Tests run side by side.
        let session = loop {
            match Session::begin() {
                Err(CallError::Busy) => std::thread::yield_now(),
                begun => break begun?,
            }
        };
        Ok(serde_json::from_str(&session.run(&arguments, Arc::new(|_| ()))?).expect("the result is JSON"))
    }

    #[test]
    fn a_command_returns_its_json() {
        let result = called("evaluate --gains 2,30 --pips 20 --breaths 1").unwrap();
        assert_eq!((&result["seed"], &result["lung"]), (&Value::from(1), &Value::from("R20C20")));
        assert!(result["mean"]["pid"]["score"].as_f64().is_some_and(|score| score > 0.5), "{result:#}");
    }

    #[test]
    fn wrong_arguments_and_failures_are_told_apart() {
        for line in ["evaluate --gain 1", "nonsense", "evaluate --gains much"] {
            let error = called(line).unwrap_err();
            assert!(matches!(&error, CallError::Usage(text) if !text.contains("Usage")), "{error}");
        }
        let error = called("evaluate --weights /nowhere.bin").unwrap_err();
        assert!(matches!(error, CallError::Failed(_)), "{error}");
    }

    #[test]
    fn a_second_command_is_refused_while_one_runs() {
        let session = loop {
            if let Ok(session) = Session::begin() {
                break session;
            }
        };
        assert!(matches!(Session::begin(), Err(CallError::Busy)));
        drop(session);
    }

    #[test]
    fn help_and_options_are_those_of_the_command_line() {
        assert!(help("evaluate").unwrap().contains("--breaths-of-learning"));
        assert!(options("evaluate").unwrap().contains(&"breaths-of-learning".to_owned()));
        assert!(help("nonsense").is_none() && options("nonsense").is_none());
    }
}
