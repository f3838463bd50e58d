//! `trainer pack`: writes a learned controller's weights image.

use std::path::PathBuf;

use serde::Serialize;
use shared::weights::decode;

use crate::args::controller::{image_id, image_of};
use crate::args::key::KeyArgs;
use crate::command::{Command, Context, Output, OutputArgs, write};

/// Pack a learned controller into the weights image for the chip
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer pack adult --out weights.bin
  trainer pack controller.safetensors --out weights.bin
  trainer pack controller.safetensors --out weights.bin --json -
  trainer pack controller.safetensors --out weights.bin --key weights.key

Before the image is written it is read back, and its controller runs once as a check.")]
pub struct Args {
    /// The controller: a shipped one, such as adult, or a file as written by `trainer train`
    #[arg(value_name = "CONTROLLER")]
    controller: PathBuf,
    /// File to write the image to
    #[arg(long, value_name = "FILE.bin")]
    out: PathBuf,
    #[command(flatten)]
    key: KeyArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    id: String,
    bytes: usize,
    period_us: u32,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let bytes = self.key.signed(image_of(&self.controller)?)?;
        let image = decode(&bytes)?;
        write(&self.out, &bytes)?;
        let id = image_id(image.id);
        context.line(&format!("saved {}: {} bytes, id {id}", self.out.display(), bytes.len()));
        Ok(Some(Summary { id, bytes: bytes.len(), period_us: image.residual.spec().period_us }))
    }
}
