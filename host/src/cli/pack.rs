//! `trainer pack`: the weights image of a learned controller.

use std::path::PathBuf;

use anyhow::Context;
use serde::Serialize;
use shared::weights::decode;

use super::common;
use super::controller_args::image_id;
use super::output::OutputArgs;
use data::files::write_atomically;

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

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let bytes = common::learned(&args.controller)?.image()?;
    let image = decode(&bytes)?;
    write_atomically(&args.out, &bytes).with_context(|| format!("cannot write {}", args.out.display()))?;
    let id = image_id(image.id);
    args.output.line(&format!("saved {}: {} bytes, id {id}", args.out.display(), bytes.len()));
    args.output.finish(&Summary { id, bytes: bytes.len(), period_us: image.residual.spec().period_us })
}
