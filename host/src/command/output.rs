//! Where the outcome of a command goes, and how its files are written: whole or not at all.

use std::io::{ErrorKind, Write};
use std::path::Path;

use anyhow::Context;
use serde::Serialize;

use super::out_file::{OutFile, is_standard_output};
use data::files::write_atomically;
use data::kind::Kind;

/// Name of the option for the results as JSON. Where they go does not matter to what a command makes.
pub(super) const JSON: &str = "json";

/// Output options.
#[derive(Debug, clap::Args)]
pub struct OutputArgs {
    /// Write the results as JSON to this file; '-' writes them, and nothing else, to standard output
    #[arg(long = JSON, value_name = "FILE", value_parser = OutFile::of(Kind::Json))]
    pub json: Option<OutFile>,
}

impl OutputArgs {
    /// JSON alone.
    pub fn json(&self) -> Output<'_> {
        self.makes(Makes::Nothing)
    }

    /// JSON beside what a command makes.
    pub fn makes<'a>(&'a self, makes: Makes<'a>) -> Output<'a> {
        Output { json: self.json.as_deref(), makes }
    }
}

/// Where the outcome of a command goes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Output<'a> {
    /// The value of `--json`, if it is given.
    pub json: Option<&'a Path>,
    /// What the command makes.
    pub makes: Makes<'a>,
}

/// What a command makes, which decides where the record of its run is kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Makes<'a> {
    /// Nothing that a record belongs to.
    #[default]
    Nothing,
    /// A folder, which contains the record.
    Folder(&'a Path),
    /// The result of an experiment: its JSON, if that is written to a file, has the record beside it.
    Experiment,
    /// A shard of a run. Its task keeps a record beside it.
    Shard,
}

impl Output<'_> {
    /// Whether standard output is for JSON alone.
    pub(super) fn is_standard_output(&self) -> bool {
        self.json.is_some_and(is_standard_output)
    }
}

/// Writes JSON to a file, or to standard output for `-`.
///
/// # Errors
/// A value that has no JSON, or a file that cannot be written.
pub fn write_json(path: &Path, value: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(value)? + "\n";
    if is_standard_output(path) {
        // That nobody reads on (`| head`) is no error.
        return match std::io::stdout().write_all(text.as_bytes()) {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => {
                Err(error).context("standard output cannot be written")
            }
            _ => Ok(()),
        };
    }
    write(path, text.as_bytes())
}

/// Writes a file atomically.
///
/// # Errors
/// A file that cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    write_atomically(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
