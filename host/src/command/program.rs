//! A program of several commands: runs the one that its arguments choose.

use std::ffi::{OsStr, OsString};
use std::fmt::Debug;
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use anyhow::Error;
use campaign::record::{Ending, Results};
use campaign::shell::quoted;
use clap::{ArgMatches, Parser};
use serde::Serialize;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::{Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

use super::bounds::stated;
use super::help::grouped;
use super::out_file;
use super::output::{Output, write_json};
use super::record::{Kept, Place, options};
use super::{Command, Context, FAILURE, Observer};

/// Environment variable that sets the log level.
const LOG_VARIABLE: &str = "EUPNEA_LOG";
/// Exit status of a command that Ctrl-C ended early, as shells expect it; its results so far are saved.
const INTERRUPTED: u8 = 130;
/// Exit status of wrong arguments, as clap has it.
const USAGE: u8 = 2;

/// A program of several commands.
pub trait Program: Parser + Debug {
    /// Its name.
    const NAME: &'static str;

    /// The group of each command in the help, in the order of the commands.
    fn groups() -> &'static [&'static str];

    /// The command that the arguments choose.
    fn chosen(&self) -> &dyn Runnable;
}

/// A command of any outcome. Every [`Command`] is one.
pub trait Runnable {
    /// Where its outcome goes.
    fn output(&self) -> Output<'_>;

    /// Runs the command and saves its outcome.
    fn run(&self, context: &Context<'_>) -> Done;
}

impl<C: Command> Runnable for C {
    fn output(&self) -> Output<'_> {
        Command::output(self)
    }

    fn run(&self, context: &Context<'_>) -> Done {
        let mut done = Done::default();
        let failed = |status| move |error| Failure { error, status };
        let outcome = Command::run(self, context).map_err(failed(FAILURE));
        done.failure = outcome
            .and_then(|outcome| {
                let Some(outcome) = outcome else { return Ok(()) };
                done.keep(&outcome, Command::output(self).json).map_err(failed(FAILURE))?;
                self.conclude(outcome, context).map_err(failed(C::REFUSED))
            })
            .err();
        done
    }
}

/// How a command ended.
#[derive(Debug, Default)]
pub struct Done {
    /// Its outcome as JSON. As text: a value would widen numbers of 32 bits, and so show other digits.
    pub json: Option<String>,
    /// The numbers among it, for the record of the run.
    pub results: Option<Results>,
    /// Why it failed, if it did.
    pub failure: Option<Failure>,
}

/// Why a command failed.
#[derive(Debug)]
pub struct Failure {
    /// The reason.
    pub error: Error,
    /// The exit status.
    pub status: u8,
}

impl Done {
    /// Keeps an outcome, and writes it to a file if there is one.
    fn keep(&mut self, outcome: &impl Serialize, file: Option<&Path>) -> anyhow::Result<()> {
        self.results = Some(Results::of(&serde_json::to_value(outcome)?));
        self.json = Some(serde_json::to_string(outcome)?);
        file.map_or(Ok(()), |file| write_json(file, outcome))
    }

    fn ending(&self, stopped: bool) -> Ending {
        match &self.failure {
            // A command that is stopped before its first result fails.
            None | Some(Failure { status: FAILURE, .. }) if stopped => Ending::Stopped,
            Some(failure) => Ending::Failed(message(&failure.error)),
            None => Ending::Complete,
        }
    }
}

/// Runs the program with the arguments of the process and returns its exit status.
pub fn main<P: Program>() -> ExitCode {
    log_to_standard_error();
    let stop = stop_at_ctrl_c();
    let arguments = with_negative_values(std::env::args_os());
    let line = line::<P>(&arguments);
    let matches = stated(grouped(P::command(), P::groups())).get_matches_from(arguments);
    let program =
        P::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut P::command()).exit());
    if let Err(error) = out_file::check(&P::command(), &matches) {
        return failed(&error, USAGE);
    }
    match run(&program, &matches, &line, &stop, None).failure {
        Some(Failure { error, status: FAILURE }) if stop.load(Ordering::Relaxed) => {
            failed(&error, INTERRUPTED)
        }
        Some(Failure { error, status }) => failed(&error, status),
        None if stop.load(Ordering::Relaxed) => ExitCode::from(INTERRUPTED),
        None => ExitCode::SUCCESS,
    }
}

/// Prints an error; the process ends with this status.
fn failed(error: &Error, status: u8) -> ExitCode {
    eprintln!("error: {}", message(error));
    ExitCode::from(status)
}

/// Joins an option with a negative number after it, as in `--gains -3,30,0`, which would be taken for another option.
fn with_negative_values(arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut joined: Vec<OsString> = Vec::new();
    for argument in arguments {
        let text = argument.to_str().unwrap_or_default();
        let number = text.strip_prefix('-').and_then(|rest| rest.chars().next());
        let is_negative =
            number.is_some_and(|first| first.is_ascii_digit() || first == '.') || text == "-inf";
        match joined.last_mut() {
            Some(option) if is_negative && is_open_option(option) => {
                option.push("=");
                option.push(&argument);
            }
            _ => joined.push(argument),
        }
    }
    joined
}

/// The command line with these arguments, the first of which is the program, as a shell takes it.
pub(super) fn line<P: Program>(arguments: &[OsString]) -> String {
    let arguments = arguments.iter().skip(1).map(|argument| format!(" {}", quoted(argument)));
    P::NAME.to_owned() + &arguments.collect::<String>()
}

/// Whether an argument is a long option without a value.
fn is_open_option(argument: &OsStr) -> bool {
    argument.to_str().is_some_and(|text| text.len() > 2 && text.starts_with("--") && !text.contains('='))
}

/// Runs the chosen command and keeps the record of its run. An observer belongs to a program that has called the command.
pub(super) fn run<P: Program>(
    program: &P,
    matches: &ArgMatches,
    line: &str,
    stop: &AtomicBool,
    observer: Option<&Observer<'_>>,
) -> Done {
    let (command, options) = (program.chosen(), options(&P::command(), matches));
    let silent = observer.is_some() || command.output().is_standard_output();
    let kept = Place::of(command.output()).map(|place| Kept::begin(place, &options));
    let lost = OnceLock::new();
    let context =
        Context { stop, observer, silent, options: &options, line, began: Instant::now(), lost: &lost };
    let mut done = command.run(&context);
    if let (None, Some(error)) = (&done.failure, lost.into_inner()) {
        let error =
            Error::new(error).context("the output is not complete: standard output cannot be written");
        done.failure = Some(Failure { error, status: FAILURE });
    }
    if let Some(kept) = kept {
        kept.end(done.ending(stop.load(Ordering::Relaxed)), done.results.clone());
    }
    done
}

/// The first Ctrl-C asks the command to stop, which keeps its results; the second ends the process.
fn stop_at_ctrl_c() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let asked = stop.clone();
    let handler = move || {
        if asked.swap(true, Ordering::SeqCst) {
            std::process::exit(INTERRUPTED.into());
        }
        eprintln!("\nstopping and keeping the results so far; press Ctrl-C again to end immediately");
    };
    if ctrlc::set_handler(handler).is_err() {
        tracing::warn!("Ctrl-C will end the process without saving: its signal cannot be handled here");
    }
    stop
}

fn log_to_standard_error() {
    let asked = std::env::var(LOG_VARIABLE).ok().and_then(|text| text.parse().ok());
    let targets = asked.unwrap_or_else(|| Targets::new().with_default(LevelFilter::WARN));
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    tracing_subscriber::registry().with(lines.with_filter(targets)).init();
}

/// An error and its causes, without a cause that the error's text already quotes.
pub(super) fn message(error: &Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_negative_number_after_an_option_is_its_value() {
        let joined = |line: &str| {
            let arguments = with_negative_values(line.split(' ').map(OsString::from));
            arguments.join(OsStr::new(" ")).into_string().unwrap()
        };
        assert_eq!(joined("collect --gains -3,30,0 --seed -1"), "collect --gains=-3,30,0 --seed=-1");
        assert_eq!(joined("judge a --rise -inf --error -.5"), "judge a --rise=-inf --error=-.5");
        for alone in ["evaluate --json - --out a", "submit -- -1", "fit --seed=1 -1", "judge -1"] {
            assert_eq!(joined(alone), alone);
        }
    }

    #[test]
    fn a_cause_is_said_once() {
        let quoted = anyhow::anyhow!("no such file").context("cannot read a.bin: no such file");
        assert_eq!(message(&quoted), "cannot read a.bin: no such file");
        let unquoted = anyhow::anyhow!("image is damaged").context("a.bin");
        assert_eq!(message(&unquoted), "a.bin: image is damaged");
    }
}
