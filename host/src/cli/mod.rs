//! The commands of the `trainer`, one file each.
//!
//! Each command reads its arguments, calls the library, prints a table and writes the requested files. All computation
//! is in the library.

mod blackbox;
mod bound;
mod breathing;
mod collect;
mod commission;
mod comparison;
mod demo;
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
mod keys;
mod margins;
mod monitor;
mod pack;
#[cfg(unix)]
mod qemu;
mod reproduce;
mod robust;
mod runs;
mod self_test;
mod serve;
#[cfg(unix)]
mod submit;
mod sweep;
mod test_table;
#[cfg(test)]
mod tests;
mod torture;
mod train;
mod train_family;
mod tune_pid;
mod tune_rival;

use clap::Parser;

use crate::command::{Program, Runnable};

/// Learned pressure control for mechanical ventilators: record, fit, train, evaluate, pack.
#[derive(Debug, Parser)]
#[command(name = "trainer", version, long_about = None, after_help = "\
Start with `cargo trainer demo`: it runs the whole pipeline on the virtual bench and shows the
result. EUPNEA_LOG sets what is logged, as in EUPNEA_LOG=debug. Research software: never for use
on a patient.")]
pub struct Cli {
    #[command(subcommand)]
    command: Commands,
}

impl Program for Cli {
    fn chosen(&self) -> &dyn Runnable {
        self.command.chosen()
    }
}

commands! {
    enum Commands {
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
        Selftest(self_test::Args),
        Blackbox(blackbox::Args),
    }
}
