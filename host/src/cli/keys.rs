//! `trainer keys`: makes the key pair with which weights are signed, or shows its public key.

use std::path::PathBuf;

use anyhow::Context as _;
use serde::Serialize;

use crate::command::{Command, Context, Output, OutputArgs};
use device::keys::{PrivateKey, hex, public_file};

/// Make a key pair for signing weights, or show its public key
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer keys --out weights.key
  trainer keys --show weights.key
  EUPNEA_WEIGHTS_KEY=$(cat weights.key.pub) cargo xtask firmware
  trainer flash weights.bin --port /dev/ttyACM0 --key weights.key

A firmware that is built with a public key runs only weights that were signed with the private key
of the pair. Without a key it is a development build, which accepts every valid image.

The private key is written for its owner alone (mode 0600) and is never overwritten. Who has it can
sign weights for every device with its public key; if it is lost, those devices need another
firmware.")]
pub struct Args {
    /// Make a key pair: the private key in this file, the public key in PATH.pub
    #[arg(long, value_name = "PATH", required_unless_present = "show")]
    out: Option<PathBuf>,
    /// Show the public key of this private key
    #[arg(long, value_name = "FILE", conflicts_with = "out")]
    show: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    public_key: String,
    id: String,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let key = if let Some(path) = &self.out {
            let key = PrivateKey::create(path)?;
            context.saved(path);
            context.saved(&public_file(path));
            key
        } else {
            PrivateKey::load(self.show.as_ref().context("give --out or --show")?)?
        };
        let summary = Summary { public_key: key.public(), id: hex(&key.id().0) };
        context.line(&format!("public key {}, named {} by devices", summary.public_key, summary.id));
        Ok(Some(summary))
    }
}
