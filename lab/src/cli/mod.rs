//! The commands of the laboratory, one file each.
//!
//! Each command reads its arguments, calls the library, prints a table and writes the requested files. All computation
//! is in the library.

mod bound;
mod endure;
mod evaluate;
mod faults;
mod margins;
mod margins_in_breaths;
pub mod program;
mod reproduce;
mod robust;
mod runs;
#[cfg(unix)]
mod submit;
mod sweep;
mod test_table;
mod torture;
mod tune_rival;

use clap::Parser;

use host::command::{ForceArgs, Program, Runnable, completions};
use host::commands;

/// The laboratory of learned pressure control: rivals, robustness, faults, margins, the paper's experiments.
#[derive(Debug, Parser)]
#[command(name = Self::NAME, version, long_about = None, after_help = "\
`cargo trainer` learns controllers and goes with a ventilator; `cargo lab` examines them. EUPNEA_LOG
sets what is logged, as in EUPNEA_LOG=debug. Research software: never for use on a patient.")]
pub struct Cli {
    #[command(subcommand)]
    command: Commands,
    #[command(flatten)]
    force: ForceArgs,
}

impl Program for Cli {
    const NAME: &'static str = "lab";

    fn groups() -> &'static [&'static str] {
        Commands::GROUPS
    }

    fn chosen(&self) -> &dyn Runnable {
        self.command.chosen()
    }
}

commands! {
    enum Commands {
        "Compare" {
            Evaluate(evaluate::Args),
            Bound(bound::Args),
            TestTable(test_table::Args),
            TuneRival(tune_rival::Args),
        }
        "Stress" {
            Robust(robust::Args),
            Margins(margins::Args),
            MarginsInBreaths(margins_in_breaths::Args),
            Faults(faults::Args),
            Torture(torture::Args),
            Endure(endure::Args),
        }
        "Run" {
            Reproduce(reproduce::Args),
            Sweep(sweep::Args),
            #[cfg(unix)]
            Submit(submit::Args),
            Runs(runs::Args),
            Completions(completions::Args<Cli>),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use clap::CommandFactory;
    use host::command::Makes;

    use super::*;

    #[test]
    fn the_arguments_of_all_commands_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_command_says_what_it_makes() {
        let folder = |path| Makes::Folder(Path::new(path));
        for (line, makes) in [
            ("sweep a.toml", folder("out/sweep")),
            ("sweep a.toml --out a --merge", folder("a")),
            ("sweep a.toml --out a --shard 1/2", Makes::Shard),
            ("reproduce --shard 1/2 --out a", Makes::Shard),
            ("torture --out a --merge", folder("a")),
            ("torture --out a", Makes::Shard),
            ("torture --shard 1/2 --out a", Makes::Shard),
            ("torture --json b.json", Makes::Experiment),
            ("endure", Makes::Experiment),
            ("robust", Makes::Experiment),
            ("tune-rival gated", Makes::Experiment),
            ("bound", Makes::Experiment),
            ("faults", Makes::Experiment),
            ("margins", Makes::Experiment),
            ("test-table", Makes::Experiment),
            ("evaluate", Makes::Experiment),
        ] {
            let cli = Cli::try_parse_from(format!("lab {line}").split(' ')).unwrap();
            assert_eq!(cli.chosen().output().makes, makes, "{line}");
        }
    }
}
