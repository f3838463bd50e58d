//! The `trainer` command line: one file per command, `common` for what they share.
//!
//! Each command reads its arguments, calls the library, prints a table and writes what was asked for. Whatever a
//! command computes is the library's; nothing is computed here.

mod common;

use clap::{Parser, Subcommand};

/// Learned pressure control for mechanical ventilators: record, fit, train, evaluate, pack.
#[derive(Debug, Parser)]
#[command(name = "trainer", version, about, long_about = None, after_help = "\
Start with `cargo trainer demo`: it runs the whole pipeline on the virtual bench and shows the result.
Research software: never for use on a patient.")]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {}

/// Runs the command of the process's arguments.
///
/// # Errors
/// What went wrong, with advice where there is any.
pub fn run() -> anyhow::Result<()> {
    common::watch_for_ctrl_c();
    match Cli::parse().command {}
}
