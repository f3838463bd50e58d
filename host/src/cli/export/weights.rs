//! Learned controllers as weights images, which a device runs.

use serde::Serialize;
use shared::weights::decode;

use super::Args;
use crate::args::controller::{image_id, image_of};
use crate::command::{Context, write};

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    id: String,
    bytes: usize,
    period_us: u32,
}

/// Writes the controller's weights image, signed if there is a key.
pub fn weights(args: &Args, context: &Context<'_>) -> anyhow::Result<Summary> {
    let bytes = args.key.signed_as(image_of(&args.file)?, args.image_version)?;
    let image = decode(&bytes)?;
    write(&args.out, &bytes)?;
    let id = image_id(image.id);
    context.line(&format!("saved {}: {} bytes, id {id}", args.out.display(), bytes.len()));
    Ok(Summary { id, bytes: bytes.len(), period_us: image.residual.spec().period_us })
}
