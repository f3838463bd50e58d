//! `trainer identify`: identifies the connected device, or the lungs in a recording.

mod connected;
mod lung;

use std::path::PathBuf;

use serde::Serialize;

use crate::command::{Command, Context, OutFile, Output, OutputArgs};
use data::kind::Kind;
use device::port::Address;

/// Identify the connected device, or the lungs in a recording
#[derive(Debug, clap::Args)]
#[command(
    group = clap::ArgGroup::new("subject").required(true).args(["port", "data"]),
    after_help = "\
Examples:
  trainer identify --port /dev/ttyACM0
  trainer identify --port tcp:localhost:5555 --json -
  trainer identify air.parquet --report lungs.html
  trainer identify air.parquet --group CT_AIR:5 --write-plant lung.toml

With --port: prints the device's identity, its firmware, the weights it contains, and its newest
calibration with its age. Nothing on the device changes; ventilation continues.

With a recording that has flows: estimates compliance C, resistance R and turbulent resistance R2 of
every lung, by least squares of P = P0 + V/C + R q + R2 q |q| over whole breaths, with 95 % intervals.
Drift of the flow sensors is removed by assuming that the inspired volume is expired again; so are a
leak and a delay of the flow. 'Behind the circuit' also removes the volume taken up by the tubes."
)]
pub struct Args {
    /// The device's address: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Option<Address>,
    /// A recording with flows
    #[arg(value_name = "FILE.parquet")]
    data: Option<PathBuf>,
    #[command(flatten)]
    lung: LungArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// Options that belong to a recording.
#[derive(Debug, clap::Args)]
struct LungArgs {
    /// Identify only this lung: a group of the recording, as the table names it
    #[arg(long, value_name = "NAME", conflicts_with = "port")]
    group: Option<String>,
    /// Write a bench description with this lung, its circuit and its pressure sensor, for --bench of other commands
    #[arg(long, value_name = "FILE.toml", conflicts_with = "port", value_parser = OutFile::of(Kind::Description))]
    write_plant: Option<OutFile>,
    /// Write estimates and fitted breaths to an HTML report
    #[arg(long, value_name = "FILE.html", conflicts_with = "port", value_parser = OutFile::of(Kind::Page))]
    report: Option<OutFile>,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Outcome {
    Device(Box<connected::Found>),
    Lungs(lung::Found),
}

impl Command for Args {
    type Outcome = Outcome;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Outcome>> {
        match (&self.port, &self.data) {
            (Some(port), _) => connected::run(port, context).map(Box::new).map(Outcome::Device),
            (None, Some(data)) => lung::run(data, &self.lung, context).map(Outcome::Lungs),
            (None, None) => anyhow::bail!("name a device with --port, or a recording"),
        }
        .map(Some)
    }
}
