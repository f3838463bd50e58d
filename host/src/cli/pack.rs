//! `trainer pack`: the weights image of a learned controller.

use std::path::PathBuf;

use serde::Serialize;
use shared::weights::decode;

use super::controller_args::image_id;
use super::output::{OutputArgs, write};
use learn::controller::learned::Learned;

/// Pack a learned controller as the weights image that the chip takes
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer pack controller.safetensors --out weights.bin
  trainer pack controller.safetensors --out weights.bin --json -

The image is read back and its controller run once before it is written.")]
pub struct Args {
    /// The controller, as trained
    #[arg(value_name = "CONTROLLER.safetensors")]
    controller: PathBuf,
    /// File to write the image to
    #[arg(long, value_name = "FILE.bin")]
    out: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
}

/// What `--json` gives.
#[derive(Debug, Serialize)]
struct Summary {
    id: String,
    bytes: usize,
    period_us: u32,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    let bytes = Learned::load(&args.controller)?.image()?;
    let image = decode(&bytes)?;
    write(&args.out, &bytes)?;
    let id = image_id(image.id);
    args.output.line(&format!("saved {}: {} bytes, id {id}", args.out.display(), bytes.len()));
    args.output.finish(&Summary { id, bytes: bytes.len(), period_us: image.residual.spec().period_us })
}
