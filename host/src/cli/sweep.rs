//! `trainer sweep`: one command with every combination of some options.

use std::path::PathBuf;

use anyhow::Context;
use campaign::Campaign;
use serde::Serialize;

use super::bars::with_bars;
use super::common::stopped;
use super::output::OutputArgs;
use super::shard_args::ShardArgs;
use experiments::sweep::{RunResult, RunResults, Sweep, SweepWork, in_words};
use show::report::{Cell, Table};

/// Run a command with every combination of some options, such as seeds or hyper-parameters
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer sweep sweep.toml --out out/sweep
  trainer submit slurm --shards 12 -- sweep sweep.toml --out out/sweep

sweep.toml, here twelve runs of the demo:
  command = \"demo --lung R20C20 --out {out}\"
  figures = [\"mean.pid\", \"mean.learned\"]
  [options]
  rounds = [1, 3]
  seed = [1, 2, 3, 4, 5, 6]

The command can be any with --json, such as demo, train, train-family, robust or evaluate; figures
are numbers in its JSON. {out} stands for a folder of the run's own. Option names are those of the
command line, without the dashes; true and false set or omit an option without a value. There are
as many runs at a time as cores, with one core each. Ctrl-C loses no complete run: the same command
continues.")]
pub struct Args {
    /// Description in TOML
    #[arg(value_name = "FILE.toml")]
    file: PathBuf,
    /// Folder of all runs
    #[arg(long, value_name = "DIR", default_value = "out/sweep")]
    out: PathBuf,
    #[command(flatten)]
    shards: ShardArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Serialize)]
struct Summary<'a> {
    #[serde(flatten)]
    sweep: &'a Sweep,
    runs: Vec<&'a RunResult>,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    let sweep = Sweep::load(&args.file)?;
    let program = std::env::current_exe().context("cannot find the path of this program")?;
    let work = SweepWork { sweep: &sweep, program, out: args.out.clone() };
    let campaign = if args.shards.divides() {
        let Some(merged) = args.shards.divided(&work, sweep.runs(), &args.out, &args.output)? else {
            return Ok(());
        };
        merged
    } else {
        let keep = args.out.join("sweep.json");
        let mut campaign = Campaign::new(&work).resumed(&keep)?;
        with_bars(|progress| campaign.advance(&work, sweep.runs(), Some(&keep), progress))?;
        campaign
    };
    args.output.table(&table(&sweep, campaign.sums()));
    if stopped() {
        args.output.line("stopped; the same command continues from here");
    }
    args.output.finish(&Summary { sweep: &sweep, runs: campaign.sums().0.values().collect() })
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
