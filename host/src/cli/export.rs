//! `trainer export`: converts files of this project for other programs.

mod code;
mod fmu;
mod network;
mod recording;
mod weights;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde::Serialize;

use crate::args::key::KeyArgs;
use crate::command::bounds::within;
use crate::command::{Command, Context, OutFile, Output, OutputArgs};
use data::export::pirds::Layout;
use data::kind::Kind;

/// Arguments of `export`.
#[derive(Debug, clap::Args)]
#[command(
    about = "Write weights images for devices; C, FMU, ONNX, MCAP or PIRDS",
    after_help = "\
Examples:
  trainer export adult --out weights.bin
  trainer export controller.safetensors --out weights.bin --key weights.key
  trainer export first.parquet --out first.mcap
  trainer export first.parquet --out first.json
  trainer export adult --out adult.c
  trainer export adult --out adult.fmu --bench R50C10
  trainer export adult --out adult.onnx
  trainer export controller.safetensors --out controller.onnx --check controller.json
  trainer export family.safetensors --unit 2 --out unit-2.onnx

The ending of --out chooses the format:
  .bin     controller as the weights image that `trainer flash` uploads: before it is written, it is
           read back, and its controller runs once as a check
  .c       controller as C99 for any chip, with its header (.h): its functions begin with the name of
           the file. It has few of a device's safeguards: docs/C_EXPORT.md
  .fmu     controller as an FMU (FMI 2.0, co-simulation) for Simulink, Modelica and others: a whole
           ventilator on a bench, with the settings as parameters
  .mcap    recording as MCAP, without loss, for Foxglove and PlotJuggler: the topics /pressure,
           /valves, /breath and /flow, and the origin
  .json    recording as a JSON array of PIRDS events, as VentDisplay loads it
  .jsonl   recording as PIRDS with one event in each line, as a VentMon sends it
  .onnx    controller or simulator as an ONNX graph, which other programs can run

PIRDS rounds: pressures to 0.1 cmH2O, flows to 1 mL/min, times to 1 ms. It has no valve commands.
`trainer import` reads it back.

In ONNX, a controller becomes one control tick, a simulator one block of ticks: the state is an
input and an output, and the number of rows is free, so that many can run side by side. The
supervisor and the safety filter are not part of a controller's file. docs/FILES.md describes all
files."
)]
pub struct Args {
    /// A recording; a controller (a shipped one, such as adult, or a file as written by `trainer train`); or a simulator's file
    #[arg(value_name = "FILE|NAME")]
    file: PathBuf,
    /// File to write; its ending chooses the format: .bin, .c, .fmu, .onnx, .mcap, .json or .jsonl
    #[arg(long, value_name = "PATH", value_parser = OutFile::named())]
    out: OutFile,
    /// The unit of a simulator of several, from 0 [default: the first unit; for a hybrid, a ventilator of no recorded one]
    #[arg(long, value_name = "N", value_parser = within::<u32>(0, u32::MAX))]
    unit: Option<u32>,
    /// With .onnx, also write inputs and what this program computes from them, to check another runtime
    #[arg(long, value_name = "FILE.json", value_parser = OutFile::of(Kind::Json))]
    check: Option<OutFile>,
    /// Bench of an FMU: a lung as in R20C20, a row of the test table as in iso-07, or a TOML file [default: R20C20]
    #[arg(long, value_name = "LUNG|FILE")]
    bench: Option<String>,
    #[command(flatten)]
    key: KeyArgs,
    /// Version of the signed weights image; devices store only newer ones [default: seconds since 1970]
    #[arg(long, value_name = "N", requires = "key", value_parser = within::<u32>(0, u32::MAX))]
    image_version: Option<u32>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Outcome {
    Weights(weights::Summary),
    Code(code::Summary),
    Fmu(fmu::Summary),
    Recording(recording::Exported),
    Network(network::Summary),
}

/// A format, by the ending of the file to write.
#[derive(Clone, Copy)]
enum Format {
    Weights,
    Code,
    Fmu,
    Mcap,
    Pirds(Layout),
    Onnx,
}

/// The endings of files, with their formats.
const FORMATS: [(&str, Format); 7] = [
    ("bin", Format::Weights),
    ("c", Format::Code),
    ("fmu", Format::Fmu),
    ("mcap", Format::Mcap),
    ("json", Format::Pirds(Layout::Array)),
    ("jsonl", Format::Pirds(Layout::Lines)),
    ("onnx", Format::Onnx),
];

impl Command for Args {
    type Outcome = Outcome;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Outcome>> {
        let format = format(&self.out)?;
        if !matches!(format, Format::Onnx) && (self.unit.is_some() || self.check.is_some()) {
            bail!(
                "--unit and --check belong to a controller or simulator: write a file that ends with .onnx"
            );
        }
        if !matches!(format, Format::Fmu) && self.bench.is_some() {
            bail!("--bench is that of an FMU: write a file that ends with .fmu");
        }
        if !matches!(format, Format::Weights) && self.key.key.is_some() {
            bail!("--key signs a weights image: write a file that ends with .bin");
        }
        match format {
            Format::Weights => weights::weights(self, context).map(Outcome::Weights),
            Format::Code => code::code(self, context).map(Outcome::Code),
            Format::Fmu => fmu::fmu(self, context).map(Outcome::Fmu),
            Format::Mcap => recording::mcap(self, context).map(Outcome::Recording),
            Format::Pirds(layout) => recording::pirds(self, layout, context).map(Outcome::Recording),
            Format::Onnx => network::onnx(self, context).map(Outcome::Network),
        }
        .map(Some)
    }
}

fn format(out: &Path) -> anyhow::Result<Format> {
    let ending = out.extension().unwrap_or_default().to_string_lossy();
    let known = FORMATS.into_iter().find(|(known, _)| *known == ending);
    known.map(|(_, format)| format).with_context(|| {
        let endings = FORMATS.map(|(ending, _)| format!(".{ending}")).join(", ");
        format!("{} has no ending of a known format: write one of {endings}", out.display())
    })
}
