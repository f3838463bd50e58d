//! The `trainer` command line from the user's side: the real program, its output, files and exit codes.

mod bad_input;
#[cfg(unix)]
mod bedside;
#[cfg(unix)]
mod blackbox;
mod commission;
mod completions;
#[cfg(unix)]
mod device;
mod export;
mod farm;
mod flash;
mod formats;
mod help;
mod interrupted;
mod judge;
mod keys;
#[cfg(unix)]
mod margins;
mod outputs;
mod pages;
mod pipeline;
mod plant;
mod python;
mod recordings;
#[cfg(unix)]
mod serve;
#[expect(dead_code, reason = "the tests on engines use the rest")]
mod support;

use std::path::PathBuf;

/// The program of every command line.
fn program_of(_line: &str) -> PathBuf {
    env!("CARGO_BIN_EXE_trainer").into()
}
