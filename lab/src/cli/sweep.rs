//! `lab sweep`: one command with every combination of some options.

use std::path::PathBuf;

use serde::Serialize;

use super::program::program_of;
use campaign::Campaign;
use experiments::sweep::{RunResult, RunResults, Sweep, SweepWork, in_words};
use host::args::shards::ShardArgs;
use host::command::{Command, Context, Output, OutputArgs};
use show::report::{Cell, Table};

/// Run a command with every combination of some options
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab sweep sweep.toml --out out/sweep
  lab submit slurm --shards 12 -- sweep sweep.toml --out out/sweep

sweep.toml, here twelve runs of the demo:
  command = \"demo --bench R20C20 --out {out}\"
  figures = [\"mean.pid\", \"mean.learned\"]
  [options]
  rounds = [1, 3]
  seed = [1, 2, 3, 4, 5, 6]

The command can be any with --json of `lab` or, if it has none of that name, of `trainer`, such as
demo, train, train-family, robust or evaluate; figures are numbers in its JSON. {out} stands for a
folder of the run's own. Option names are those of the command line, without the dashes; true and
false set or omit an option without a value. There are as many runs at a time as cores, with one
core each. Ctrl-C loses no complete run: the same command continues.")]
pub struct Args {
    /// Description in TOML
    #[arg(value_name = "FILE.toml")]
    file: PathBuf,
    /// Folder of all runs
    #[arg(long, value_name = "PATH", default_value = "out/sweep")]
    out: PathBuf,
    #[command(flatten)]
    shards: ShardArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Serialize)]
pub struct Summary {
    #[serde(flatten)]
    sweep: Sweep,
    runs: Vec<RunResult>,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(self.shards.makes(&self.out))
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let sweep = Sweep::load(&self.file)?;
        let program = program_of(sweep.command.split_whitespace().next().unwrap_or_default())?;
        let work = SweepWork { sweep: &sweep, program, out: self.out.clone() };
        let campaign = if self.shards.divides() {
            let Some(merged) = self.shards.divided(&work, sweep.runs(), &self.out, context)? else {
                return Ok(None);
            };
            merged
        } else {
            let keep = self.out.join("sweep.json");
            let mut campaign = Campaign::new(&work).resumed(&keep)?;
            context.progress(|progress| campaign.advance(&work, sweep.runs(), Some(&keep), progress))?;
            campaign
        };
        context.table(&table(&sweep, campaign.sums()));
        if context.stopped() {
            context.line("stopped; the same command continues from here");
        }
        let runs = campaign.sums().0.values().cloned().collect();
        Ok(Some(Summary { sweep, runs }))
    }
}

/// A row for every run. No best value is marked, because a figure may be an error or a share.
fn table(sweep: &Sweep, results: &RunResults) -> Table {
    let header: Vec<&str> =
        ["run", "options"].into_iter().chain(sweep.figures.iter().map(String::as_str)).collect();
    let mut table = Table::new("Runs", &header);
    for (number, result) in &results.0 {
        let mut row = vec![Cell::right(number.to_string()), Cell::text(in_words(&result.options))];
        row.extend(result.figures.iter().map(|figure| Cell::number(*figure, 3)));
        table.row(row);
    }
    table
}
