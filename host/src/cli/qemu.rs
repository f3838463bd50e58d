//! `trainer qemu`: the virtual board, for a person or a program to connect to.

use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

use anyhow::bail;

use super::common::{BenchArgs, stopped};
use emulator::{Emulator, EmulatorConfig, LockstepPlant, Paced};
use plant::bench::BenchPlant;

/// Control period of the board.
const PERIOD: Duration = Duration::from_millis(1);
/// How often it is looked whether the board still runs.
const LOOK: Duration = Duration::from_millis(100);

/// Run the real firmware on a virtual board: QEMU with the virtual bench as its lung
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer qemu --listen 5555
  trainer qemu --listen 5555 --lung R50C10 --folder board   (keeps the weights in flash)
  trainer monitor --port tcp:localhost:5555                (in another terminal)

The images come from `cargo xtask firmware`, QEMU from `cargo xtask setup`. Time runs as on a real
board; with --fast it runs as fast as the machine allows. Ctrl-C switches the board off.")]
pub struct Args {
    /// TCP port for the device's link; 0 takes any that is free
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    listen: u16,
    #[command(flatten)]
    bench: BenchArgs,
    /// Folder that keeps the board's flash from run to run [default: erased at every start]
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,
    /// Do not wait for real time
    #[arg(long)]
    fast: bool,
    #[command(flatten)]
    images: ImageArgs,
}

/// Where the images are.
#[derive(Debug, clap::Args)]
pub struct ImageArgs {
    /// Folder of the firmware's images
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

pub fn run(args: &Args) -> anyhow::Result<()> {
    let bench = args.bench.one()?;
    let config = EmulatorConfig { folder: args.folder.clone(), link: args.listen, ..args.images.board() };
    let plant = LockstepPlant::new(BenchPlant::new(&bench)?);
    let mut board = if args.fast {
        Emulator::start(config, plant)?
    } else {
        Emulator::start(config, Paced::new(plant, PERIOD))?
    };
    println!("the board breathes {}; connect to it with --port tcp:{}", bench.name, board.address());
    while !stopped() {
        if let Some(status) = board.exit_status()? {
            bail!("QEMU ended, {status}: {}", board.log());
        }
        sleep(LOOK);
    }
    Ok(())
}
