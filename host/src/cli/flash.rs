//! `trainer flash`: writes weights to a device over its link, or the firmware through a debug probe or USB.

mod firmware;
mod usb;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use firmware_file::ReleaseKey;
use serde::Serialize;
use shared::weights::decode;
use shared::weights::slots::Slot;

use crate::args::controller::{image_id, read};
use crate::args::key::KeyArgs;
use crate::args::port::warn_of_development_build;
use crate::command::{Command, Context, Output, OutputArgs};
use data::tensors;
use device::Device;
use device::port::Address;
use learn::controller::learned::{KIND, Learned};

/// Write weights to a device, or firmware by probe or USB
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer flash weights.bin --port /dev/ttyACM0
  trainer flash weights.bin --port tcp:localhost:5555 --no-reset
  trainer flash weights.bin --port /dev/ttyACM0 --key weights.key
  trainer flash --firmware eupnea-0.1.0-stm32f405.zip --for stm32f405
  trainer flash --firmware eupnea-0.1.0-stm32f405.zip --for stm32f405 --dfu
  trainer flash target/firmware/board.elf

Weights go into the slot that is not running, are read back, and run after a restart. Until then,
and if anything goes wrong, the old weights stay. An interrupted upload continues where it stopped.
A device that is ventilating refuses an upload. A device with a key refuses weights that are not
signed with it (--key), not newer than its own, or for another plant.

The file of a release has program and weights of one board, and a signature, which is verified
before anything is erased. It is loaded with probe-rs, or by USB (--dfu) if the board's chip was
reset with BOOT0 high.")]
pub struct Args {
    /// Weights image, as written by `trainer export`, for the device at --port; or an image of your own (.elf) for the debug probe
    #[arg(value_name = "FILE", required_unless_present = "firmware")]
    image: Option<PathBuf>,
    /// The device's address: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Option<Address>,
    /// Store the weights, but keep the old ones running until the next restart
    #[arg(long)]
    no_reset: bool,
    /// Firmware from a release: eupnea-VERSION-BOARD.zip
    #[arg(long, value_name = "FILE", requires = "board", conflicts_with_all = ["image", "port"])]
    firmware: Option<PathBuf>,
    /// The board to load firmware into: stm32f405, which is the default for an .elf, stm32f446, or one on the desk, such as stm32f446-desk
    #[arg(long = "for", value_name = "NAME", conflicts_with = "port")]
    board: Option<String>,
    /// Public key that must have signed the release, 64 hexadecimal digits [default: the key built into this program, if any]
    #[arg(long, value_name = "KEY", requires = "firmware")]
    trust: Option<ReleaseKey>,
    /// Load by USB instead of through a debug probe
    #[arg(long, requires = "firmware")]
    dfu: bool,
    #[command(flatten)]
    key: KeyArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Summary {
    /// Weights were stored.
    Weights {
        /// Their id.
        weights_id: String,
        /// Where.
        slot: Slot,
        /// The weights that run now; none if the device was not restarted.
        running: Option<String>,
    },
    /// The firmware of a release was loaded.
    Firmware {
        /// Its version.
        version: String,
        /// Its revision of the source.
        revision: String,
        /// Its board.
        board: String,
    },
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        match (&self.firmware, &self.image, &self.port) {
            (Some(file), _, _) => self.flash_release(file, context).map(Some),
            (None, Some(image), None) if is_program(image) => {
                firmware::load_own(image, self.board.as_deref(), context).map(|()| None)
            }
            (None, Some(image), Some(port)) if !is_program(image) => {
                flash_weights(self, image, port, context).map(Some)
            }
            (_, _, Some(_)) => bail!("firmware is loaded through the debug probe: leave out --port"),
            (_, Some(image), None) if image.extension().is_some_and(|ending| ending == "zip") => {
                bail!("the file of a release is for --firmware, with the name of your board at --for")
            }
            _ => {
                bail!("name the device of the weights with --port; firmware is a file that ends with .elf")
            }
        }
    }
}

impl Args {
    fn flash_release(&self, file: &Path, context: &Context<'_>) -> anyhow::Result<Summary> {
        let package = firmware::open(file, self.trust, self.board.as_deref().unwrap_or_default())?;
        let release = &package.manifest.firmware;
        context.line(&format!(
            "{} {} (revision {}) for {}: signature and files verified",
            release.image, release.version, release.revision, release.board
        ));
        if self.dfu {
            usb::flash(&package, context)?;
            context.line("loaded and read back; set BOOT0 low and press the board's reset button");
        } else {
            firmware::load(&package)?;
            context.line(firmware::LOADED);
        }
        Ok(Summary::Firmware {
            version: release.version.clone(),
            revision: release.revision.clone(),
            board: release.board.clone(),
        })
    }
}

/// Whether a file is a program rather than weights.
fn is_program(image: &Path) -> bool {
    image.extension().is_some_and(|ending| ending == "elf")
}

fn flash_weights(args: &Args, file: &Path, port: &Address, context: &Context<'_>) -> anyhow::Result<Summary> {
    let image = read(file)?;
    if let Err(error) = decode(&image) {
        // A controller's file has the better reason: its architecture, or that it is not packed yet.
        if tensors::kind(file).is_ok_and(|kind| kind == KIND) {
            Learned::load(file)?;
            let file = file.display();
            bail!("{file} is no weights image yet: write one with `trainer export {file} --out weights.bin`");
        }
        return Err(error).with_context(|| file.display().to_string());
    }
    let image = args.key.signed(image)?;
    let mut device = Device::connect(port)?;
    warn_of_development_build(&device.identify()?);
    let uploaded = context.progress(|progress| device.upload(&image, progress))?;
    let id = image_id(uploaded.id);
    context.line(&format!("weights {id} are stored and verified in slot {:?}", uploaded.slot));
    let mut now = None;
    if args.no_reset {
        context.line("the new weights run after the next restart");
    } else {
        now = device.restart()?.running_id().map(image_id);
        let running = now.as_deref().unwrap_or("no weights");
        if running != id {
            bail!(
                "after the restart the device runs {running}; check it with: trainer identify --port {port}"
            );
        }
        context.line("restarted: the new weights run now");
    }
    Ok(Summary::Weights { weights_id: id, slot: uploaded.slot, running: now })
}
