//! `trainer import`: recordings from tables measured elsewhere.

use std::path::PathBuf;

use clap::Subcommand;
use serde::Serialize;

use super::output::OutputArgs;
use crate::dataset::respiraworks::{ImportSummary, import};

/// Make a recording from tables measured elsewhere
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer import respiraworks CT_AIR.csv --out ct-air.parquet
  trainer import respiraworks --help")]
pub struct Args {
    #[command(subcommand)]
    from: From,
}

#[derive(Debug, Subcommand)]
enum From {
    Respiraworks(RespiraworksArgs),
}

#[derive(Debug, clap::Args)]
#[command(
    about = "The RespiraWorks ventilator's test runs: 100 Hz, blower, test lung",
    after_help = "\
Examples:
  trainer import respiraworks CT_AIR.csv --out ct-air.parquet
  trainer import respiraworks CT_AIR.csv NPV_AIR.csv --out air.parquet --json -"
)]
struct RespiraworksArgs {
    /// Tables to join, in this order
    #[arg(value_name = "FILE.csv", required = true)]
    files: Vec<PathBuf>,
    /// File to write the recording to
    #[arg(long, value_name = "FILE.parquet")]
    out: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
}

/// What `--json` gives.
#[derive(Debug, Serialize)]
struct Summary {
    rows: usize,
    kept: usize,
    tests: usize,
    breaths: usize,
    complete_breaths: usize,
    period_us: u32,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let From::Respiraworks(args) = &args.from;
    let (recording, summary) = import(&args.files)?;
    recording.save(&args.out)?;
    args.output.line(&summary.to_string());
    args.output.line(&format!("saved {}", args.out.display()));
    let ImportSummary { rows, kept, tests, breaths, complete_breaths, period_us, .. } = summary;
    args.output.finish(&Summary { rows, kept, tests, breaths, complete_breaths, period_us })
}
