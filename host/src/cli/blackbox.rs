//! `trainer blackbox`: reads a device's flight recorder.

use std::path::{Path, PathBuf};

use serde::Serialize;
use shared::link::messages::DeviceIdentity;

use super::bars::with_bars;
use super::output::{OutputArgs, write, write_json};
use device::Device;
use device::blackbox::Blackbox;
use device::port::Address;
use show::blackbox::{csv, events, report, summary};
use show::monitor::words;

/// Read a device's flight recorder: the last seconds before a fault, and what happened when
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer blackbox --port /dev/ttyACM0
  trainer blackbox --port /dev/ttyACM0 --out fault.csv --html fault.html
  trainer blackbox --port tcp:localhost:5555 --json - --clear

It holds the last 2 s of control ticks, the last 60 s at a twentieth of their rate, and a log of a
thousand events. It records while the device ventilates and for a short time after a fault or a
stop; then it stands still until ventilation starts again. It survives a reset, which ends a running
recording, but no lost supply. A device that ventilates goes on.")]
pub struct Args {
    /// The device: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Address,
    /// Write the recorded ticks as CSV, or everything as JSON
    #[arg(long, value_name = "FILE.csv|FILE.json", value_parser = out)]
    out: Option<PathBuf>,
    /// Write a page with plots of pressure, target and valve, and the whole log
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// How many of the newest events to print
    #[arg(long, value_name = "N", default_value_t = 40)]
    events: usize,
    /// Then empty the recording; the log stays
    #[arg(long)]
    clear: bool,
    #[command(flatten)]
    output: OutputArgs,
}

/// What `--json` gives.
#[derive(Debug, Serialize)]
struct Found<'a> {
    port: String,
    identity: &'a DeviceIdentity,
    #[serde(flatten)]
    blackbox: &'a Blackbox,
}

/// A file whose name says what to write.
fn out(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match kind(&path) {
        Some("csv" | "json") => Ok(path),
        _ => Err("name it *.csv for the ticks or *.json for everything".to_owned()),
    }
}

fn kind(path: &Path) -> Option<&str> {
    path.extension().and_then(|extension| extension.to_str())
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut device = Device::connect(&args.port)?;
    let identity = device.identify()?;
    let blackbox = with_bars(|progress| device.blackbox(progress))?;
    let port = args.port.to_string();
    let name = format!("{port}: {}", words::identity(&identity));
    args.output.table(&summary(&blackbox, &name));
    args.output.table(&events(&blackbox, args.events));
    let found = Found { port, identity: &identity, blackbox: &blackbox };
    if let Some(path) = &args.out {
        match kind(path) {
            Some("csv") => write(path, csv(&blackbox).as_bytes())?,
            _ => write_json(path, &found)?,
        }
        args.output.saved(path);
    }
    args.output.report(args.html.as_ref(), || Ok(report(&blackbox, &name)))?;
    args.output.finish(&found)?;
    // Only what is saved is given up.
    if args.clear {
        device.clear_recorder()?;
        args.output.line("the recording is emptied; the log stays");
    }
    Ok(())
}
