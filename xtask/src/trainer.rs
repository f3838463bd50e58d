//! The programs `trainer` and `lab`, built with the same packages and profile as the tests: another selection of packages would build its
//! dependencies again, and another profile everything.

use std::path::{Path, PathBuf};

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::firmware::cargo_folder;

/// The built programs.
pub struct Trainer<'a> {
    shell: &'a Shell,
    program: PathBuf,
}

impl<'a> Trainer<'a> {
    /// Builds the programs, unless a test run has built them.
    pub fn build(shell: &'a Shell) -> Result<Self> {
        cmd!(shell, "cargo test --quiet --workspace --exclude firmware --test command_line --no-run")
            .quiet()
            .run()?;
        Ok(Self { shell, program: cargo_folder(shell).join("debug/trainer") })
    }

    /// Path of the trainer.
    pub fn program(&self) -> &Path {
        &self.program
    }

    /// Runs a command line of the trainer, split at spaces; `words` replaces placeholders by arguments that contain spaces.
    pub fn run(&self, line: &str, words: &[(&str, &str)]) -> Result<()> {
        self.run_program(&self.program, line, words)
    }

    /// Runs a command line of the laboratory like [`Self::run`].
    pub fn lab(&self, line: &str, words: &[(&str, &str)]) -> Result<()> {
        self.run_program(&self.program.with_file_name("lab"), line, words)
    }

    fn run_program(&self, program: &Path, line: &str, words: &[(&str, &str)]) -> Result<()> {
        let arguments = line
            .split_whitespace()
            .map(|word| words.iter().find(|(name, _)| *name == word).map_or(word, |(_, long)| *long));
        Ok(cmd!(self.shell, "{program} {arguments...}").quiet().run()?)
    }
}
