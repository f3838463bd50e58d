//! The commands of the `trainer`, one file each.
//!
//! Each command reads its arguments, calls the library, prints a table and writes the requested files. All computation
//! is in the library.

mod blackbox;
mod breathing;
mod collect;
mod commission;
mod comparison;
mod demo;
pub mod evaluate;
mod export;
mod farm;
mod fit;
mod flash;
mod identify;
mod import;
mod inspect;
mod judge;
mod keys;
mod margins;
mod monitor;
#[cfg(unix)]
mod qemu;
mod self_test;
mod serve;
#[cfg(test)]
mod tests;
mod train;
mod train_family;
mod tune_pid;

use clap::Parser;

use crate::args::controller::ControllerArgs;
use crate::command::{ForceArgs, Program, Runnable, completions};

/// Learned pressure control for mechanical ventilators: record, fit, train, evaluate, flash.
#[derive(Debug, Parser)]
#[command(name = Self::NAME, version, long_about = None, after_help = "\
Start with `cargo trainer demo`: it runs the whole pipeline on the virtual bench and shows the
result. EUPNEA_LOG sets what is logged, as in EUPNEA_LOG=debug. Research software: never for use
on a patient.")]
pub struct Cli {
    #[command(subcommand)]
    command: Commands,
    #[command(flatten)]
    force: ForceArgs,
}

impl Program for Cli {
    const NAME: &'static str = "trainer";

    fn groups() -> &'static [&'static str] {
        Commands::GROUPS
    }

    fn chosen(&self) -> &dyn Runnable {
        self.command.chosen()
    }
}

commands! {
    enum Commands {
        "Start" {
            Demo(demo::Args),
            Completions(completions::Args<Cli>),
        }
        "Learn" {
            Collect(collect::Args),
            TunePid(tune_pid::Args),
            Fit(fit::Args),
            Train(train::Args),
            TrainFamily(train_family::Args),
            Commission(commission::Args),
            Farm(farm::Args),
        }
        "Judge" {
            Evaluate(evaluate::Args<ControllerArgs>),
            Judge(judge::Args),
            Margins(margins::Args),
        }
        "Data" {
            Import(import::Args),
            Export(export::Args),
            Inspect(inspect::Args),
        }
        "Device" {
            Identify(identify::Args),
            Selftest(self_test::Args),
            Flash(flash::Args),
            Keys(keys::Args),
            Monitor(monitor::Args),
            Serve(serve::Args),
            Blackbox(blackbox::Args),
            #[cfg(unix)]
            Qemu(qemu::Args),
        }
    }
}
