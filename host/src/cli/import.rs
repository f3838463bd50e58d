//! `trainer import`: converts third-party recordings.

use std::path::PathBuf;

use anyhow::bail;

use crate::args::map::MapArgs;
use crate::command::{Command, Context, OutFile, Output, OutputArgs};
use data::import::account::ImportSummary;
use data::import::{import, import_pirds};
use data::kind::Kind;

/// Convert third-party recordings: tables, or events of PIRDS
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer import CT_AIR.csv NPV_AIR.csv --map respiraworks --out air.parquet
  trainer import train.csv --map kaggle --out kaggle.parquet --json summary.json
  trainer import measured.csv --map columns.toml --out measured.parquet
  trainer import ventmon.json --out ventmon.parquet

Units are converted. Gaps, and rows that belong to no breath, are counted. The summary reports
rates, ranges, quantum, noise and the share of saturated rows (docs/RECORDINGS.md).

--map respiraworks is for test runs of the RespiraWorks ventilator: 100 Hz, blower, test lung.
--map kaggle is for the competition 'Ventilator Pressure Prediction': every breath's uneven time
steps are put on an even grid of their median, and six million rows need less than 1 GiB. Any other
table needs a column map of its own; this one is minimal, for time in ms, pressure in hPa and valve
commands of 0 to 1:

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

Without --map the files contain events of the respiration data standard PIRDS, such as those of a
VentMon: a JSON array, or one JSON event in each line. The airway pressure (type D at location A, I
or D; else P, less the ambient one) and the flow (F) become the recording. Breaths begin at the
messages of `trainer export`; without any, the flow or else the pressure shows them. Events that are
not used are counted by name.")]
pub struct Args {
    /// Files to join, in this order
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    map: MapArgs,
    /// File to write the recording to (.parquet)
    #[arg(long, value_name = "PATH", value_parser = OutFile::of(Kind::Recording))]
    out: OutFile,
    #[command(flatten)]
    output: OutputArgs,
}

impl Command for Args {
    type Outcome = ImportSummary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<ImportSummary>> {
        let Self { files, out, .. } = self;
        let summary = if let Some(map) = self.map.chosen()? {
            let layout = map.layout()?;
            context.progress(|progress| import(files, &layout, out, progress))?
        } else {
            let table = |file: &&PathBuf| file.extension().is_some_and(|ending| ending == "csv");
            if let Some(table) = files.iter().find(table) {
                bail!("{} is a table: name its column map with --map", table.display());
            }
            context.progress(|progress| import_pirds(files, out, progress))?
        };
        context.line(&summary.to_string());
        context.saved(out);
        Ok(Some(summary))
    }
}
