//! Where results go: tables to the terminal, JSON to a file or to standard output, which it then has to itself.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::common::write_json;
use show::report::Table;

/// How results are given out.
#[derive(Debug, clap::Args)]
pub struct OutputArgs {
    /// Write the results as JSON; '-' writes them to standard output, and nothing else
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl OutputArgs {
    /// Prints a table, unless standard output belongs to the JSON.
    pub fn table(&self, table: &Table) {
        self.line(&format!("{}\n", table.to_terminal()));
    }

    /// Prints a line, unless standard output belongs to the JSON.
    pub fn line(&self, text: &str) {
        if self.json.as_deref() != Some(Path::new("-")) {
            print(text);
        }
    }

    /// Writes the JSON, if it was asked for.
    pub fn finish(&self, results: &impl Serialize) -> anyhow::Result<()> {
        match &self.json {
            Some(path) => write_json(path, results),
            None => Ok(()),
        }
    }
}

/// Prints a line. A reader that has gone (`| head`) is no reason to stop: files are still to be written.
fn print(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}
