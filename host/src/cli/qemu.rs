//! `trainer qemu`: runs the virtual board and lets a client connect to it.

use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

use anyhow::bail;

use crate::args::bench::BenchArgs;
use crate::command::{Command, Context};
use emulator::{Emulator, EmulatorConfig, LockstepPlant, Paced};
use plant::bench::BenchPlant;

/// Control period of the board.
const PERIOD: Duration = Duration::from_millis(1);
/// Interval of the checks whether the board still runs.
const LOOK: Duration = Duration::from_millis(100);

/// Run the real firmware on a virtual board: QEMU with the virtual bench as its lung
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer qemu --listen 5555
  trainer qemu --listen 5555 --lung R50C10 --folder board   (keeps the weights in flash)
  trainer monitor --port tcp:localhost:5555                (in another terminal)

`cargo xtask firmware` builds the images, `cargo xtask setup` installs QEMU. Time runs as on a real
board; with --fast it runs as fast as the host allows. Ctrl-C switches the board off.")]
pub struct Args {
    /// TCP port for the device's link; 0 picks a free port
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    listen: u16,
    #[command(flatten)]
    bench: BenchArgs,
    /// Folder that keeps the board's flash between runs [default: flash erased at every start]
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,
    /// Run as fast as possible, not in real time
    #[arg(long)]
    fast: bool,
    #[command(flatten)]
    images: ImageArgs,
}

/// The location of the firmware images.
#[derive(Debug, clap::Args)]
pub struct ImageArgs {
    /// Folder with the firmware images
    #[arg(long, value_name = "FOLDER", default_value = "target/firmware")]
    images: PathBuf,
}

impl ImageArgs {
    /// A board with hardware in the loop.
    pub fn board(&self) -> EmulatorConfig {
        let image = |name: &str| self.images.join(name);
        EmulatorConfig { firmware: image("hil.elf"), shim: image("shim.elf"), ..EmulatorConfig::default() }
    }
}

impl Command for Args {
    type Outcome = ();

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<()>> {
        let bench = self.bench.one()?;
        let config = EmulatorConfig { folder: self.folder.clone(), link: self.listen, ..self.images.board() };
        let plant = LockstepPlant::new(BenchPlant::new(&bench)?);
        let mut board = if self.fast {
            Emulator::start(config, plant)?
        } else {
            Emulator::start(config, Paced::new(plant, PERIOD))?
        };
        println!("the board ventilates {}; connect to it with --port tcp:{}", bench.name, board.address());
        while !context.stopped() {
            if let Some(status) = board.exit_status()? {
                bail!("QEMU ended with {status}: {}", board.log());
            }
            sleep(LOOK);
        }
        Ok(None)
    }
}
