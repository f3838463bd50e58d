//! The program of a command: this one, or the trainer beside it.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use clap::CommandFactory;

use super::Cli;

/// The program that has a command: this one if it has the command, otherwise the trainer.
///
/// # Errors
/// A trainer that is not in the folder of this program.
pub fn program_of(command: &str) -> anyhow::Result<PathBuf> {
    let this = std::env::current_exe().context("cannot find the path of this program")?;
    if is_ours(command) {
        return Ok(this);
    }
    let trainer = this.with_file_name(format!("trainer{}", std::env::consts::EXE_SUFFIX));
    ensure!(
        trainer.exists(),
        "{command} is a command of the trainer, which is not at {}: build it with `cargo build --release --bin trainer`",
        trainer.display()
    );
    Ok(trainer)
}

/// Whether this program has the command.
pub fn is_ours(command: &str) -> bool {
    Cli::command().find_subcommand(command).is_some()
}
