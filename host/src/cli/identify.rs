//! `trainer identify`: who is at a port, or which lung is in a recording.

mod connected;
mod lung;

use std::path::PathBuf;

use super::output::OutputArgs;
use device::port::Address;

/// Ask a device who it is, or find out what a recorded lung is
#[derive(Debug, clap::Args)]
#[command(
    group = clap::ArgGroup::new("subject").required(true).args(["port", "data"]),
    after_help = "\
Examples:
  trainer identify --port /dev/ttyACM0
  trainer identify --port tcp:localhost:5555 --json -
  trainer identify --data air.parquet --report lungs.html
  trainer identify --data air.parquet --group CT_AIR:5 --write-plant lung.toml

With --port: who the device is, what it runs and which weights it holds. Nothing on it is
changed; one that ventilates goes on.

With --data: compliance C, resistance R and its turbulent part R2 of every lung in a recording
that has flows, by least squares of P = P0 + V/C + R q + R2 q |q| over whole breaths, with 95 %
intervals from the spread of the breaths. Drift of the flow sensors is taken out: what went in
comes out again. 'Behind the circuit' takes out what the tubes take, too."
)]
pub struct Args {
    /// A device: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Option<Address>,
    /// A recording with flows
    #[arg(long, value_name = "FILE.parquet")]
    data: Option<PathBuf>,
    #[command(flatten)]
    lung: LungArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// What goes with `--data`.
#[derive(Debug, clap::Args)]
struct LungArgs {
    /// This lung alone: a group of the recording, as the table names it
    #[arg(long, value_name = "NAME", conflicts_with = "port")]
    group: Option<String>,
    /// Write a bench with this lung, its circuit and its pressure sensor, for --bench of other commands
    #[arg(long, value_name = "FILE.toml", conflicts_with = "port")]
    write_plant: Option<PathBuf>,
    /// Write estimates and fitted breaths as an HTML report
    #[arg(long, value_name = "FILE.html", conflicts_with = "port")]
    report: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    match (&args.port, &args.data) {
        (Some(port), _) => connected::run(port, &args.output),
        (None, Some(data)) => lung::run(data, &args.lung, &args.output),
        (None, None) => anyhow::bail!("name a device with --port or a recording with --data"),
    }
}
