//! `trainer import`: converts third-party recordings.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use tempfile::TempDir;

use crate::args::map::MapArgs;
use crate::command::{Command, Context, OutFile, Output, OutputArgs, write};
use data::import::account::ImportSummary;
use data::import::format::Format;
use data::import::{import_as, propose};
use data::kind::Kind;

/// Convert third-party recordings: tables or files of ventilators
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer import CT_AIR.csv NPV_AIR.csv --out air.parquet
  trainer import short.record --out makair.parquet
  trainer import export.csv --propose-map columns.toml
  trainer import export.csv --map columns.toml --out measured.parquet
  ssh bedside cat export.csv.gz | trainer import - --map columns.toml --out measured.parquet

The content tells the format:

  makair        telemetry of a MakAir, versions 1 and 2
  pb840         Puritan Bennett 840: blocks of flow and pressure from BS to BE, 50 Hz
  servo-u       recordings of a SERVO-U ([REC]), in any language
  pirds         events of the respiration data standard PIRDS, such as those of a VentMon
  kaggle        the competition 'Ventilator Pressure Prediction'
  respiraworks  test runs of the RespiraWorks ventilator
  csv           any other table, which needs a column map

--propose-map writes a map with the reason of each guess: correct it. This one is minimal, for flow
in L/min and pressure in cmH2O at 50 Hz:

  period_ms = 20
  [pressure]
  column = \"Paw\"
  [flow]
  column = \"Flow\"
  unit = \"L/min\"

Files may be compressed (gzip), in UTF-8, UTF-16 or Latin-1. Breaths are found by a breath column, the
set-point, the expiratory valve, the flow or the pressure, the first of these that the files have.
Units are converted, uneven rows are put on an even grid, and the account tells what became of each
row (docs/RECORDINGS.md).")]
pub struct Args {
    /// Files to join, in this order; `-` for standard input
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// Format of the files [default: told by their content]
    #[arg(long, value_name = "NAME", value_parser = Format::NAMES)]
    format: Option<String>,
    #[command(flatten)]
    map: MapArgs,
    /// Write a proposed column map for the first file to this file (.toml), and import nothing
    #[arg(long, value_name = "FILE", value_parser = OutFile::of(Kind::Description))]
    propose_map: Option<OutFile>,
    /// File to write the recording to (.parquet)
    #[arg(long, value_name = "PATH", value_parser = OutFile::of(Kind::Recording), required_unless_present = "propose_map")]
    out: Option<OutFile>,
    #[command(flatten)]
    output: OutputArgs,
}

impl Command for Args {
    type Outcome = ImportSummary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<ImportSummary>> {
        let spooled = Spooled::of(&self.files)?;
        let files = &spooled.files;
        if let Some(map) = &self.propose_map {
            let proposed = propose(&files[0])?;
            context.line(&proposed);
            write(map, proposed.as_bytes())?;
            context.saved(map);
        }
        let Some(out) = &self.out else { return Ok(None) };
        let format = self.map.format(&files[0], self.format.as_deref())?;
        let summary = context.progress(|progress| import_as(&format, files, out, progress))?;
        context.line(&summary.to_string());
        context.saved(out);
        Ok(Some(summary))
    }
}

/// The files to read: standard input is kept in a temporary file, because it is read more than once.
struct Spooled {
    files: Vec<PathBuf>,
    _folder: Option<TempDir>,
}

impl Spooled {
    fn of(files: &[PathBuf]) -> anyhow::Result<Self> {
        let is_input = |file: &PathBuf| file == Path::new("-");
        let Some(place) = files.iter().position(is_input) else {
            return Ok(Self { files: files.to_vec(), _folder: None });
        };
        let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
        let path = folder.path().join("standard-input");
        let copied = File::create(&path).and_then(|mut file| io::copy(&mut io::stdin(), &mut file));
        copied.context("cannot keep standard input in a temporary file")?;
        let mut files = files.to_vec();
        files[place] = path;
        if files.iter().any(is_input) {
            bail!("standard input can be read once: name `-` once");
        }
        Ok(Self { files, _folder: Some(folder) })
    }
}
