//! The trainer, built with the same packages and profile as the tests: another selection of packages would build its
//! dependencies again, and another profile everything.

use std::path::{Path, PathBuf};

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::firmware::cargo_folder;

/// A built trainer.
pub struct Trainer<'a> {
    shell: &'a Shell,
    program: PathBuf,
}

impl<'a> Trainer<'a> {
    /// Builds the trainer, unless a test run has built it.
    pub fn build(shell: &'a Shell) -> Result<Self> {
        cmd!(shell, "cargo test --quiet --workspace --exclude firmware --test command_line --no-run")
            .quiet()
            .run()?;
        Ok(Self { shell, program: cargo_folder(shell).join("debug/trainer") })
    }

    /// Its path.
    pub fn program(&self) -> &Path {
        &self.program
    }

    /// Runs a command line, split at spaces; `words` replaces placeholders by arguments that contain spaces.
    pub fn run(&self, line: &str, words: &[(&str, &str)]) -> Result<()> {
        let program = &self.program;
        let arguments = line
            .split_whitespace()
            .map(|word| words.iter().find(|(name, _)| *name == word).map_or(word, |(_, long)| *long));
        Ok(cmd!(self.shell, "{program} {arguments...}").quiet().run()?)
    }
}
