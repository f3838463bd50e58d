//! `trainer import`: converts third-party recordings.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Subcommand;

use super::bars::with_bars;
use super::output::OutputArgs;
use data::import::account::ImportSummary;
use data::import::import_pirds;
use data::import::map::ColumnMap;

/// Convert third-party recordings
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer import respiraworks CT_AIR.csv --out ct-air.parquet
  trainer import kaggle train.csv --out kaggle.parquet
  trainer import csv measured.csv --map columns.toml --out measured.parquet
  trainer import pirds ventmon.json --out ventmon.parquet
  trainer import respiraworks --help

Units are converted. Gaps, and rows that belong to no breath, are counted. The summary reports
rates, ranges, quantum, noise and the share of saturated rows (docs/RECORDINGS.md).")]
pub struct Args {
    #[command(subcommand)]
    from: From,
}

#[derive(Debug, Subcommand)]
enum From {
    #[command(
        about = "Convert test runs of the RespiraWorks ventilator: 100 Hz, blower, test lung",
        after_help = "\
Examples:
  trainer import respiraworks CT_AIR.csv --out ct-air.parquet
  trainer import respiraworks CT_AIR.csv NPV_AIR.csv --out air.parquet --json -"
    )]
    Respiraworks(FileArgs),
    /// Convert the layout of the Kaggle competition 'Ventilator Pressure Prediction'
    #[command(after_help = "\
Examples:
  trainer import kaggle train.csv --out kaggle.parquet
  trainer import kaggle train.csv --out kaggle.parquet --json summary.json

Columns: breath_id, R, C, time_step, u_in, u_out and pressure. Every breath's uneven time steps are
put on an even grid of their median. The file is streamed: six million rows need less than 1 GiB.")]
    Kaggle(FileArgs),
    Csv(CsvArgs),
    #[command(
        about = "Convert events of the respiration data standard PIRDS, such as those of a VentMon",
        after_help = "\
Examples:
  trainer import pirds breaths.json --out breaths.parquet
  trainer import pirds breaths.jsonl --out breaths.parquet --json -
  trainer judge breaths.parquet

A JSON array or one JSON event in each line. The airway pressure (type D at location A, I or D; else
P, less the ambient one) and the flow (F) become the recording. Breaths begin at the messages of
`trainer export`; without any, the flow or else the pressure shows them. Events that are not used
are counted by name."
    )]
    Pirds(EventArgs),
}

/// Input and output files of events.
#[derive(Debug, clap::Args)]
struct EventArgs {
    /// Files to join, in this order
    #[arg(value_name = "FILE.json", required = true)]
    files: Vec<PathBuf>,
    /// File to write the recording to
    #[arg(long, value_name = "FILE.parquet")]
    out: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
}

/// Convert any table, with a column map that names the columns and their units
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer import csv measured.csv --map columns.toml --out measured.parquet

A minimal column map, for a table with time in ms, pressure in hPa and valve commands of 0 to 1:

  [time]
  column = \"t\"
  unit = \"ms\"
  [pressure]
  column = \"Paw\"
  unit = \"hPa\"
  [u_in]
  column = \"inhale\"
  unit = \"share\"
  [u_out]
  column = \"exhale\"
  unit = \"share\"

docs/RECORDINGS.md lists all names and units.")]
struct CsvArgs {
    /// Column map (TOML): names and units of the table's columns
    #[arg(long, value_name = "COLUMNS.toml")]
    map: PathBuf,
    #[command(flatten)]
    files: FileArgs,
}

/// Input and output files.
#[derive(Debug, clap::Args)]
struct FileArgs {
    /// Tables to join, in this order
    #[arg(value_name = "FILE.csv", required = true)]
    files: Vec<PathBuf>,
    /// File to write the recording to
    #[arg(long, value_name = "FILE.parquet")]
    out: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    match &args.from {
        From::Respiraworks(files) => import(files, &ColumnMap::respiraworks()?),
        From::Kaggle(files) => import(files, &ColumnMap::kaggle()?),
        From::Csv(args) => {
            let map = ColumnMap::load(&args.map).with_context(|| args.map.display().to_string())?;
            import(&args.files, &map)
        }
        From::Pirds(args) => {
            let summary = with_bars(|progress| import_pirds(&args.files, &args.out, progress))?;
            report(&summary, &args.out, &args.output)
        }
    }
}

fn import(args: &FileArgs, map: &ColumnMap) -> anyhow::Result<()> {
    let layout = map.layout()?;
    let summary = with_bars(|progress| data::import::import(&args.files, &layout, &args.out, progress))?;
    report(&summary, &args.out, &args.output)
}

fn report(summary: &ImportSummary, out: &Path, output: &OutputArgs) -> anyhow::Result<()> {
    output.line(&summary.to_string());
    output.saved(out);
    output.finish(summary)
}
