//! The `trainer` command line: one file per command, and `common` for shared arguments.
//!
//! Each command reads its arguments, calls the library, prints a table and writes the requested files. All computation
//! is in the library.

mod bars;
mod blackbox;
mod bound;
mod breathing;
mod collect;
mod commission;
mod common;
mod comparison;
mod controller_args;
mod demo;
pub mod embedded;
mod endure;
mod evaluate;
mod export;
mod farm;
mod faults;
mod fit;
mod flash;
mod identify;
mod import;
mod inspect;
mod judge;
mod key_args;
mod keys;
mod made_by;
mod margins;
mod monitor;
mod output;
mod pack;
mod plant_args;
mod policy_args;
mod port_args;
#[cfg(unix)]
mod qemu;
mod reproduce;
mod robust;
mod runs;
mod self_test;
mod serve;
mod settings_args;
mod shard_args;
mod source_args;
#[cfg(unix)]
mod submit;
mod sweep;
mod test_table;
mod torture;
mod train;
mod train_family;
mod tune_pid;
mod tune_rival;

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::{Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

/// Learned pressure control for mechanical ventilators: record, fit, train, evaluate, pack.
#[derive(Debug, Parser)]
#[command(name = "trainer", version, long_about = None, after_help = "\
Start with `cargo trainer demo`: it runs the whole pipeline on the virtual bench and shows the
result. EUPNEA_LOG sets what is logged, as in EUPNEA_LOG=debug. Research software: never for use
on a patient.")]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    Collect(collect::Args),
    TunePid(tune_pid::Args),
    TuneRival(tune_rival::Args),
    Bound(bound::Args),
    Fit(fit::Args),
    Train(train::Args),
    TrainFamily(train_family::Args),
    Commission(commission::Args),
    Farm(farm::Args),
    Evaluate(evaluate::Args),
    Reproduce(reproduce::Args),
    Pack(pack::Args),
    Export(export::Args),
    Keys(keys::Args),
    Flash(flash::Args),
    #[cfg(unix)]
    Qemu(qemu::Args),
    Inspect(inspect::Args),
    Import(import::Args),
    Judge(judge::Args),
    Identify(identify::Args),
    Monitor(monitor::Args),
    Serve(serve::Args),
    Faults(faults::Args),
    Torture(torture::Args),
    Endure(endure::Args),
    Robust(robust::Args),
    #[cfg(unix)]
    Submit(submit::Args),
    Sweep(sweep::Args),
    Runs(runs::Args),
    Margins(margins::Args),
    TestTable(test_table::Args),
    #[command(name = "selftest")]
    SelfTest(self_test::Args),
    Blackbox(blackbox::Args),
}

/// Environment variable that sets the log level.
const LOG_VARIABLE: &str = "EUPNEA_LOG";
/// Exit code of a command that Ctrl-C ended early, as shells expect it; its results so far are saved.
const INTERRUPTED: u8 = 130;
/// Exit code of `trainer judge` if a breath violates a declared limit.
const VIOLATED: u8 = 3;

/// Runs the command given by the process's arguments and returns its exit code.
pub fn run() -> ExitCode {
    log_to_standard_error();
    common::watch_for_ctrl_c();
    let matches = Cli::command().get_matches();
    let cli =
        Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut Cli::command()).exit());
    match made_by::recorded(&Cli::command(), &matches, || dispatch(&cli.command)) {
        Ok(()) if common::stopped() => ExitCode::from(INTERRUPTED),
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", message(&error));
            if error.is::<judge::Violated>() { ExitCode::from(VIOLATED) } else { ExitCode::FAILURE }
        }
    }
}

fn dispatch(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(args) => demo::run(args),
        Command::Collect(args) => collect::run(args),
        Command::TunePid(args) => tune_pid::run(args),
        Command::TuneRival(args) => tune_rival::run(args),
        Command::Bound(args) => bound::run(args),
        Command::Fit(args) => fit::run(args),
        Command::Train(args) => train::run(args),
        Command::TrainFamily(args) => train_family::run(args),
        Command::Commission(args) => commission::run(args),
        Command::Farm(args) => farm::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Reproduce(args) => reproduce::run(args),
        Command::Pack(args) => pack::run(args),
        Command::Export(args) => export::run(args),
        Command::Keys(args) => keys::run(args),
        Command::Flash(args) => flash::run(args),
        #[cfg(unix)]
        Command::Qemu(args) => qemu::run(args),
        Command::Inspect(args) => inspect::run(args),
        Command::Import(args) => import::run(args),
        Command::Judge(args) => judge::run(args),
        Command::Identify(args) => identify::run(args),
        Command::Monitor(args) => monitor::run(args),
        Command::Serve(args) => serve::run(args),
        Command::Faults(args) => faults::run(args),
        Command::Torture(args) => torture::run(args),
        Command::Endure(args) => endure::run(args),
        Command::Robust(args) => robust::run(args),
        #[cfg(unix)]
        Command::Submit(args) => submit::run(args),
        Command::Sweep(args) => sweep::run(args),
        Command::Runs(args) => runs::run(args),
        Command::Margins(args) => margins::run(args),
        Command::TestTable(args) => test_table::run(args),
        Command::SelfTest(args) => self_test::run(args),
        Command::Blackbox(args) => blackbox::run(args),
    }
}

fn log_to_standard_error() {
    let asked = std::env::var(LOG_VARIABLE).ok().and_then(|text| text.parse().ok());
    let targets = asked.unwrap_or_else(|| Targets::new().with_default(LevelFilter::WARN));
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    tracing_subscriber::registry().with(lines.with_filter(targets)).init();
}

/// An error and its causes, without a cause that the error's text already quotes.
fn message(error: &anyhow::Error) -> String {
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
    fn the_arguments_of_all_commands_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_cause_is_said_once() {
        let quoted = anyhow::anyhow!("no such file").context("cannot read a.bin: no such file");
        assert_eq!(message(&quoted), "cannot read a.bin: no such file");
        let unquoted = anyhow::anyhow!("image is damaged").context("a.bin");
        assert_eq!(message(&unquoted), "a.bin: image is damaged");
    }
}
