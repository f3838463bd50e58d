//! Output of results: tables to the terminal, JSON to a file or to standard output, which then contains only JSON.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;

use super::{embedded, made_by};
use data::files::write_atomically;
use show::report::{Report, Table};

/// Output options.
#[derive(Debug, clap::Args)]
pub struct OutputArgs {
    /// Write the results as JSON to this file; '-' writes them, and nothing else, to standard output
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl OutputArgs {
    /// Prints a table, unless JSON goes to standard output.
    pub fn table(&self, table: &Table) {
        self.line(&format!("{}\n", table.to_terminal()));
    }

    /// Prints a line, unless JSON goes to standard output or another program has called the command.
    pub fn line(&self, text: &str) {
        if self.json.as_deref() != Some(Path::new("-")) && !embedded::is_called() {
            // A closed reader (`| head`) is no reason to stop: files are still to be written.
            let _ = writeln!(std::io::stdout(), "{text}");
        }
    }

    /// Reports that a file was written.
    pub fn saved(&self, path: &Path) {
        self.line(&format!("saved {}", path.display()));
    }

    /// Writes a report, if requested.
    pub fn report(
        &self,
        path: Option<&PathBuf>,
        report: impl FnOnce() -> anyhow::Result<Report>,
    ) -> anyhow::Result<()> {
        let Some(path) = path else { return Ok(()) };
        report()?.save(path)?;
        self.saved(path);
        Ok(())
    }

    /// Writes the JSON, if requested, and keeps its numbers for the record of the run.
    pub fn finish(&self, results: &impl Serialize) -> anyhow::Result<()> {
        made_by::keep(results)?;
        embedded::keep(results)?;
        match &self.json {
            Some(path) => write_json(path, results),
            None => Ok(()),
        }
    }
}

/// Writes JSON to a file, or to standard output for `-`.
pub fn write_json(path: &Path, value: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(value)? + "\n";
    if path == Path::new("-") {
        return Ok(std::io::stdout().write_all(text.as_bytes())?);
    }
    write(path, text.as_bytes())
}

/// Writes a file atomically.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    write_atomically(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
