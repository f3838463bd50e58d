//! `trainer blackbox`: reads a device's flight recorder.

use std::path::Path;

use clap::builder::TypedValueParser;
use serde::Serialize;
use shared::link::messages::DeviceIdentity;

use crate::command::bounds::{MOST, within};
use crate::command::{Command, Context, OutFile, Output, OutputArgs, write, write_json};
use data::kind::Kind;
use device::Device;
use device::blackbox::Blackbox;
use device::port::Address;
use show::blackbox::{csv, events, report, summary};
use show::monitor::words;

/// Read a device's flight recorder after a fault
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer blackbox --port /dev/ttyACM0
  trainer blackbox --port /dev/ttyACM0 --out fault.csv --report fault.html
  trainer blackbox --port tcp:localhost:5555 --json - --clear

The recorder contains the last 2 s of control ticks, the last 60 s at a twentieth of their rate, and
a log of a thousand events. It records while the device ventilates and for a short time after a
fault or a stop; then it pauses until ventilation starts again. Its contents survive a reset (which
ends a running recording). A board with room for it copies them to flash when ventilation has ended;
after a loss of power that copy is read, and the output says so. A device that is ventilating
continues.")]
pub struct Args {
    /// The device's address: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Address,
    /// Write the recorded ticks (*.csv) or everything (*.json) to this file
    #[arg(long, value_name = "PATH", value_parser = OutFile::named().try_map(csv_or_json))]
    out: Option<OutFile>,
    /// Write plots of pressure, target and valve, and the whole log, to an HTML report
    #[arg(long, value_name = "FILE.html", value_parser = OutFile::of(Kind::Page))]
    report: Option<OutFile>,
    /// Print only the newest N events
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = within::<usize>(0, MOST))]
    events: usize,
    /// Then clear the recorded ticks; the event log stays
    #[arg(long)]
    clear: bool,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Serialize)]
pub struct Found {
    port: String,
    identity: DeviceIdentity,
    #[serde(flatten)]
    blackbox: Blackbox,
    /// The connection, for what is to follow.
    #[serde(skip)]
    device: Device,
}

/// Checks that the file name ends in .csv or .json.
fn csv_or_json(path: OutFile) -> Result<OutFile, String> {
    match kind(&path) {
        Some("csv" | "json") => Ok(path),
        _ => Err("the file name must end in .csv (ticks) or .json (everything)".to_owned()),
    }
}

fn kind(path: &Path) -> Option<&str> {
    path.extension().and_then(|extension| extension.to_str())
}

impl Command for Args {
    type Outcome = Found;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Found>> {
        let mut device = Device::connect(&self.port)?;
        let identity = device.identify()?;
        let blackbox = context.progress(|progress| device.blackbox(progress))?;
        let port = self.port.to_string();
        let name = format!("{port}: {}", words::identity(&identity));
        context.table(&summary(&blackbox, &name));
        context.table(&events(&blackbox, self.events));
        let found = Found { port, identity, blackbox, device };
        if let Some(path) = &self.out {
            match kind(path) {
                Some("csv") => write(path, csv(&found.blackbox).as_bytes())?,
                _ => write_json(path, &found)?,
            }
            context.saved(path);
        }
        context.report(self.report.as_deref(), || Ok(report(&found.blackbox, &name)))?;
        Ok(Some(found))
    }

    /// Clears only what was written successfully.
    fn conclude(&self, mut outcome: Found, context: &Context<'_>) -> anyhow::Result<()> {
        if self.clear {
            outcome.device.clear_recorder()?;
            context.line("the recorded ticks are cleared; the event log stays");
        }
        Ok(())
    }
}
