//! `trainer import`: converts third-party recordings.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Subcommand;

use crate::command::{Command, Context, Output, OutputArgs};
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

impl Command for Args {
    type Outcome = ImportSummary;

    fn output(&self) -> Output<'_> {
        match &self.from {
            From::Respiraworks(files) | From::Kaggle(files) => files.output.json(),
            From::Csv(args) => args.files.output.json(),
            From::Pirds(args) => args.output.json(),
        }
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<ImportSummary>> {
        match &self.from {
            From::Respiraworks(files) => import(files, &ColumnMap::respiraworks()?, context),
            From::Kaggle(files) => import(files, &ColumnMap::kaggle()?, context),
            From::Csv(csv) => {
                let map = ColumnMap::load(&csv.map).with_context(|| csv.map.display().to_string())?;
                import(&csv.files, &map, context)
            }
            From::Pirds(events) => {
                let summary =
                    context.progress(|progress| import_pirds(&events.files, &events.out, progress))?;
                Ok(report(summary, &events.out, context))
            }
        }
        .map(Some)
    }
}

fn import(args: &FileArgs, map: &ColumnMap, context: &Context<'_>) -> anyhow::Result<ImportSummary> {
    let layout = map.layout()?;
    let summary =
        context.progress(|progress| data::import::import(&args.files, &layout, &args.out, progress))?;
    Ok(report(summary, &args.out, context))
}

fn report(summary: ImportSummary, out: &Path, context: &Context<'_>) -> ImportSummary {
    context.line(&summary.to_string());
    context.saved(out);
    summary
}
