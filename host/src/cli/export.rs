//! `trainer export`: converts files of this project for other programs.

mod network;
mod recording;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde::Serialize;

use crate::command::{Command, Context, Output, OutputArgs};
use data::export::pirds::Layout;

/// Arguments of `export`.
#[derive(Debug, clap::Args)]
#[command(
    about = "Convert a recording to MCAP or PIRDS, or a learned controller or simulator to ONNX",
    after_help = "\
Examples:
  trainer export first.parquet --out first.mcap
  trainer export first.parquet --out first.json
  trainer export adult --out adult.onnx
  trainer export controller.safetensors --out controller.onnx --check controller.json
  trainer export family.safetensors --unit 2 --out unit-2.onnx

The ending of --out chooses the format:
  .mcap    recording as MCAP, without loss, for Foxglove and PlotJuggler: the topics /pressure,
           /valves, /breath and /flow, and the origin
  .json    recording as a JSON array of PIRDS events, as VentDisplay loads it
  .jsonl   recording as PIRDS with one event in each line, as a VentMon sends it
  .onnx    controller or simulator as an ONNX graph, which other programs can run

PIRDS rounds: pressures to 0.1 cmH2O, flows to 1 mL/min, times to 1 ms. It has no valve commands.
`trainer import pirds` reads it back.

In ONNX, a controller becomes one control tick, a simulator one block of ticks: the state is an
input and an output, and the number of rows is free, so that many can run side by side. The
supervisor and the safety filter are not part of a controller's file. docs/FILES.md describes all
files."
)]
pub struct Args {
    /// A recording; a controller (a shipped one, such as adult, or a file as written by `trainer train`); or a simulator's file
    #[arg(value_name = "FILE|NAME")]
    file: PathBuf,
    /// File to write; its ending chooses the format
    #[arg(long, value_name = "FILE.mcap|.json|.jsonl|.onnx")]
    out: PathBuf,
    /// The unit of a simulator of several, from 0 [default: the first unit; for a hybrid, a ventilator of no recorded one]
    #[arg(long, value_name = "N")]
    unit: Option<u32>,
    /// With .onnx, also write inputs and what this program computes from them, to check another runtime
    #[arg(long, value_name = "FILE.json")]
    check: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Outcome {
    Recording(recording::Exported),
    Network(network::Summary),
}

/// A format, by the ending of the file to write.
#[derive(Clone, Copy)]
enum Format {
    Mcap,
    Pirds(Layout),
    Onnx,
}

/// The endings of files, with their formats.
const FORMATS: [(&str, Format); 4] = [
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
        match format {
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
