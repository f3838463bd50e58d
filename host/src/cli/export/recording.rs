//! Recordings as MCAP and PIRDS.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde::Serialize;

use super::Args;
use crate::command::Context;
use data::export::mcap::{self, Counts};
use data::export::pirds::{self, Layout, Written};
use data::recording::Recording;

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Exported {
    file: PathBuf,
    rows: usize,
    /// Number of messages of each topic of an MCAP file.
    #[serde(skip_serializing_if = "Option::is_none")]
    messages: Option<Counts>,
    /// Number of PIRDS events.
    #[serde(skip_serializing_if = "Option::is_none")]
    events: Option<Written>,
}

/// Writes the recording as MCAP.
pub fn mcap(args: &Args, context: &Context<'_>) -> anyhow::Result<Exported> {
    let recording = recording(&args.file)?;
    let messages = Some(mcap::save(&recording, &args.out)?);
    context.saved(&args.out);
    Ok(Exported { messages, events: None, ..exported(args, &recording) })
}

/// Writes the recording as PIRDS.
pub fn pirds(args: &Args, layout: Layout, context: &Context<'_>) -> anyhow::Result<Exported> {
    let recording = recording(&args.file)?;
    let events = Some(pirds::save(&recording, layout, &args.out)?);
    context.saved(&args.out);
    Ok(Exported { events, messages: None, ..exported(args, &recording) })
}

fn exported(args: &Args, recording: &Recording) -> Exported {
    Exported { file: args.out.to_path_buf(), rows: recording.len(), messages: None, events: None }
}

/// Reads a recording, whose first bytes or else its ending tell that it is one.
fn recording(file: &Path) -> anyhow::Result<Recording> {
    let unreadable = || format!("cannot read {}", file.display());
    let mut start = Vec::new();
    File::open(file).and_then(|file| file.take(4).read_to_end(&mut start)).with_context(unreadable)?;
    if start == b"PAR1" || file.extension().is_some_and(|ending| ending == "parquet") {
        return Ok(Recording::load(file)?);
    }
    bail!(
        "{} is not a recording: give a .parquet file of the trainer, or write a controller or simulator as .onnx",
        file.display()
    )
}
