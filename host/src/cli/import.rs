//! `trainer import`: converts third-party recordings.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
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

/// The files to read: standard input and pipes are kept in temporary files, because an import reads its files more than once.
struct Spooled {
    files: Vec<PathBuf>,
    _folder: TempDir,
}

impl Spooled {
    fn of(files: &[PathBuf]) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
        let mut inputs = 0;
        let spool = |(n, file): (usize, &PathBuf)| -> anyhow::Result<PathBuf> {
            let is_input = file == Path::new("-");
            let is_pipe = fs::metadata(file).is_ok_and(|there| !there.is_file() && !there.is_dir());
            if !is_input && !is_pipe {
                return Ok(file.clone());
            }
            inputs += usize::from(is_input);
            ensure!(inputs < 2, "standard input can be read once: name `-` once");
            let path = folder.path().join(format!("input-{n}"));
            let mut copy = File::create(&path)?;
            if is_input {
                io::copy(&mut io::stdin(), &mut copy)?;
            } else {
                io::copy(&mut File::open(file)?, &mut copy)?;
            }
            Ok(path)
        };
        let files = files.iter().enumerate().map(spool).collect::<anyhow::Result<Vec<_>>>();
        Ok(Self { files: files.context("cannot keep the input in a temporary file")?, _folder: folder })
    }
}
