//! `trainer flash`: writes weights to a device over its link, or the firmware through a debug probe.

use std::path::{Path, PathBuf};
use std::process;

use anyhow::{Context as _, bail};
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

/// The main board's chip, as probe-rs names it.
const CHIP: &str = "STM32F405RG";

/// Write weights to a device, or its firmware through a debug probe
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer flash weights.bin --port /dev/ttyACM0
  trainer flash weights.bin --port tcp:localhost:5555 --no-reset
  trainer flash weights.bin --port /dev/ttyACM0 --key weights.key
  trainer flash target/firmware/board.elf

Weights go into the slot that is not running, are read back, and run after a restart. Until then,
and if anything goes wrong, the old weights stay. An interrupted upload continues where it stopped.
A device that is ventilating refuses an upload. A device with a key refuses weights that are not
signed with it (--key), not newer than its own, or for another plant. The firmware is loaded with
probe-rs.")]
pub struct Args {
    /// Weights image, as written by `trainer export`, for the device at --port; or a firmware image (.elf) for the debug probe
    #[arg(value_name = "FILE")]
    image: PathBuf,
    /// The device's address: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Option<Address>,
    /// Store the weights, but keep the old ones running until the next restart
    #[arg(long)]
    no_reset: bool,
    /// The chip that the firmware is built for
    #[arg(long, value_name = "NAME", default_value = CHIP, conflicts_with = "port")]
    chip: String,
    #[command(flatten)]
    key: KeyArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    weights_id: String,
    slot: Slot,
    running: Option<String>,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let firmware = self.image.extension().is_some_and(|ending| ending == "elf");
        match &self.port {
            Some(port) if !firmware => flash_weights(self, &self.image, port, context).map(Some),
            None if firmware => flash_firmware(&self.image, &self.chip, context).map(|()| None),
            Some(_) => bail!("firmware is loaded through the debug probe: leave out --port"),
            None => {
                bail!("name the device of the weights with --port; firmware is a file that ends with .elf")
            }
        }
    }
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
    let mut summary = Summary { weights_id: id.clone(), slot: uploaded.slot, running: None };
    if args.no_reset {
        context.line("the new weights run after the next restart");
    } else {
        summary.running = device.restart()?.running_id().map(image_id);
        let running = summary.running.as_deref().unwrap_or("no weights");
        if running != id {
            bail!(
                "after the restart the device runs {running}; check it with: trainer identify --port {port}"
            );
        }
        context.line("restarted: the new weights run now");
    }
    Ok(summary)
}

fn flash_firmware(image: &Path, chip: &str, context: &Context<'_>) -> anyhow::Result<()> {
    if !image.exists() {
        bail!("{} does not exist; build it with: cargo xtask firmware", image.display());
    }
    let status = match process::Command::new("probe-rs")
        .args(["download", "--verify", "--chip", chip])
        .arg(image)
        .status()
    {
        Ok(status) => status,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            bail!("probe-rs is not installed; install it with: cargo install probe-rs-tools --locked")
        }
        Err(error) => return Err(error).context("cannot run probe-rs"),
    };
    if !status.success() {
        bail!("probe-rs failed (see above): check that the probe is plugged in and the board powered");
    }
    context.line("loaded and verified; press the board's reset button, or switch it off and on");
    Ok(())
}
