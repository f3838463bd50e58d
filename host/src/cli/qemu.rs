//! `trainer qemu`: runs the virtual board and lets a client connect to it.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use anyhow::bail;

use crate::args::bench::BenchArgs;
use crate::args::listen::listen;
use crate::command::{Command, Context};
use emulator::{Emulator, EmulatorConfig, LockstepPlant, Paced};
use plant::bench::BenchPlant;

/// Control period of the board.
const PERIOD: Duration = Duration::from_millis(1);
/// Interval of the checks whether the board still runs.
const LOOK: Duration = Duration::from_millis(100);

/// Run the real firmware in QEMU, with a virtual lung
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer qemu --listen 5555
  trainer qemu --listen 5555 --bench R50C10 --folder board   (keeps the weights in flash)
  trainer monitor --port tcp:localhost:5555                (in another terminal)

`cargo xtask firmware` builds the images, and a release has them in eupnea-VERSION-qemu.zip;
`cargo xtask setup` installs QEMU. Time runs as on a real board; with --fast it runs as fast as the
host allows. Ctrl-C switches the board off.")]
pub struct Args {
    /// Address at which the device's link listens; port 0 picks a free one
    #[arg(long, value_name = "[IP:]PORT", value_parser = listen, default_value = "0")]
    listen: SocketAddr,
    #[command(flatten)]
    bench: BenchArgs,
    /// Folder that keeps the board's flash between runs [default: flash erased at every start]
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
    /// Run as fast as possible, not in real time
    #[arg(long)]
    fast: bool,
    /// Folder with the firmware images
    #[arg(long, value_name = "DIR", default_value = IMAGES)]
    images: PathBuf,
}

/// Where `cargo xtask firmware` puts the images.
pub const IMAGES: &str = "target/firmware";

/// A board with hardware in the loop, with the firmware images in a folder.
pub fn board(images: &Path) -> EmulatorConfig {
    let image = |name: &str| images.join(name);
    EmulatorConfig { firmware: image("hil.elf"), shim: image("shim.elf"), ..EmulatorConfig::default() }
}

impl Command for Args {
    type Outcome = ();

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<()>> {
        let bench = self.bench.one()?;
        let config =
            EmulatorConfig { folder: self.folder.clone(), link: Some(self.listen), ..board(&self.images) };
        let plant = LockstepPlant::new(BenchPlant::new(&bench)?);
        let mut running = if self.fast {
            Emulator::start(config, plant)?
        } else {
            Emulator::start(config, Paced::new(plant, PERIOD))?
        };
        let address = running.address();
        context
            .line(&format!("the board ventilates {}; connect to it with --port tcp:{address}", bench.name));
        while !context.stopped() {
            if let Some(status) = running.exit_status()? {
                bail!("QEMU ended with {status}: {}", running.log());
            }
            sleep(LOOK);
        }
        Ok(None)
    }
}
