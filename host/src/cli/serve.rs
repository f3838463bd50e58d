//! `trainer serve`: shows devices in a browser.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use anyhow::ensure;

use crate::args::listen::listen;
use crate::args::map::{MapArgs, load};
use crate::args::port::warn_of_development_build;
use crate::command::{Command, Context};
use bedside::demo;
use bedside::replay;
use bedside::server::{Options, Server};
use bedside::source::Watch;
use device::port::Address;
use plant::bench::BenchConfig;

/// Show devices in a browser: waveforms, figures, alarms, steering
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer serve --demo
  trainer serve --port /dev/ttyACM0
  trainer serve --port tcp:localhost:5555 --port /dev/ttyACM1 --steer
  trainer serve --bench R20C20 --steer
  trainer serve --recording night.parquet --recording fault.json

Open the address that the command prints. The page shows every device at 1 kHz and never asks
another server for anything. Ctrl-C ends the server; devices at a port keep running, simulated
ones (--bench, --demo) end with it.

Without --steer pages only read. With it, the printed address contains a token, without which
nothing is changed; one page at a time steers a device. The server listens on this computer only,
unless --listen names another address: then even reading needs the token, which crosses the network
unencrypted. To watch from another computer, an SSH tunnel is safer: ssh -L 8080:localhost:8080 HOST")]
pub struct Args {
    /// A device's address: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT; repeat it for more devices
    #[arg(long, value_name = "PORT")]
    port: Vec<Address>,
    /// A simulated device on this bench: a lung as in R20C20, or a TOML file; repeat it for more devices
    #[arg(long, value_name = "LUNG|FILE")]
    bench: Vec<String>,
    /// Replay a recording (*.parquet), a flight recorder that `trainer blackbox --out FILE.json` has written or, with --map, a table,
    /// in the time in which it was recorded; repeat it for more
    #[arg(long, value_name = "FILE")]
    recording: Vec<PathBuf>,
    #[command(flatten)]
    map: MapArgs,
    /// Show the nine lungs of the paper, each with a PID and beside it with the shipped learned controller, with buttons that inject faults
    #[arg(long, conflicts_with_all = ["port", "bench", "recording"])]
    demo: bool,
    /// Address at which the server listens
    #[arg(long, value_name = "[IP:]PORT", value_parser = listen, default_value = "8080")]
    listen: SocketAddr,
    /// Folder into which pages with the token record
    #[arg(long, value_name = "DIR", default_value = ".")]
    records: PathBuf,
    /// Allow the page with the printed token to start, stop and set the devices
    #[arg(long)]
    steer: bool,
}

/// Interval between looks at Ctrl-C.
const LOOK_EVERY: Duration = Duration::from_millis(100);

impl Command for Args {
    type Outcome = ();

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<()>> {
        // Nobody can be harmed by steering a simulated device.
        let steer = self.steer || self.demo;
        let options = Options { listen: self.listen, steer, demo: self.demo, folder: self.records.clone() };
        let server = Server::start(watches(self, context)?, &options)?;
        context.line(&server.url());
        if server.token().is_some() {
            eprintln!("the part after # is the token: anyone who has it may {}", allowed(steer));
        }
        if server.is_reachable() {
            let port = server.address().port();
            eprintln!(
                "warning: other computers reach this server, and nothing is encrypted: anyone who can read the network can read the token. \
             Safer: leave --listen out, and on the other computer use `ssh -L {port}:localhost:{port} THIS-COMPUTER`. \
             Without that, put this computer's address into the one above"
            );
        }
        eprintln!(
            "open this address in a browser; Ctrl-C ends the server; devices at a port keep running, simulated ones end"
        );
        while !context.stopped() {
            sleep(LOOK_EVERY);
        }
        Ok(None)
    }
}

/// What the token allows.
fn allowed(steer: bool) -> &'static str {
    if steer { "steer the devices" } else { "watch the devices" }
}

fn watches(args: &Args, context: &Context<'_>) -> anyhow::Result<Vec<Watch>> {
    if args.demo {
        return Ok(demo::start()?);
    }
    let mut watches = Vec::new();
    for address in &args.port {
        let (watch, identity) = Watch::port(address);
        match identity {
            Ok(identity) => warn_of_development_build(&identity),
            Err(reason) => eprintln!("warning: {reason}; it is tried again while the page is served"),
        }
        watches.push(watch);
    }
    for name in &args.bench {
        for (title, bench) in benches(name)? {
            watches.push(Watch::bench(title, &bench)?);
        }
    }
    ensure!(
        !args.map.is_given() || !args.recording.is_empty(),
        "--map is for tables: name one with --recording"
    );
    for path in &args.recording {
        if path.extension().is_some_and(|ending| ending == "json") {
            watches.extend(replay::blackbox(path)?);
        } else {
            let recording = load(path, &args.map, context)?;
            watches.push(replay::recording(&path.display().to_string(), &recording)?);
        }
    }
    Ok(watches)
}

/// The benches of a file or of a lung's name, each with its title.
fn benches(name: &str) -> anyhow::Result<Vec<(String, BenchConfig)>> {
    let benches = BenchConfig::find(name)?;
    let several = benches.len() > 1;
    let stem = BenchConfig::file(name).and_then(Path::file_stem);
    let name = stem.map_or_else(|| name.to_owned(), |stem| stem.display().to_string());
    let title = |number: usize| if several { format!("{name} {}", number + 1) } else { name.clone() };
    Ok(benches.into_iter().enumerate().map(|(number, bench)| (title(number), bench)).collect())
}
