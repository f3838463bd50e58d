//! Learned controllers as C.

use anyhow::Context as _;
use learn::c_export::{Source, source};
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

/// Writes the controller as C, with its header.
pub fn code(args: &Args, context: &Context<'_>) -> anyhow::Result<Summary> {
    let image = decode(&image_of(&args.file)?).with_context(|| args.file.display().to_string())?;
    let name = args.out.file_stem().unwrap_or_default().to_string_lossy();
    let Source { code, header } = source(&image, &name)?;
    let header_file = args.out.header().context("a controller in C has a header")?;
    write(&args.out, code.as_bytes())?;
    write(&header_file, header.as_bytes())?;
    let (id, period_us) = (image_id(image.id), image.residual.spec().period_us);
    context.line(&format!(
        "saved {} and {}: {period_us} us, id {id}",
        args.out.display(),
        header_file.display()
    ));
    Ok(Summary { id, bytes: code.len() + header.len(), period_us })
}
