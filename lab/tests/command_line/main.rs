//! The `lab` command line from the user's side: the real program, its output, files and exit codes.

mod commands_page;
mod endure;
mod help;
mod interrupted;
mod margins;
mod options;
mod policy;
#[path = "../../../host/tests/command_line/python.rs"]
mod python;
mod rivals;
mod robust;
mod runs;
mod shards;
#[path = "../../../host/tests/command_line/support.rs"]
#[expect(dead_code, reason = "the tests of the trainer and of the engines use the rest")]
mod support;
mod test_table;
mod written;

use std::path::{Path, PathBuf};

use lab::cli::program::is_ours;

/// The program of a command line: the laboratory's or, for a command that it does not have, the trainer beside it.
fn program_of(line: &str) -> PathBuf {
    let lab = Path::new(env!("CARGO_BIN_EXE_lab"));
    let trainer = lab.with_file_name(format!("trainer{}", std::env::consts::EXE_SUFFIX));
    let is_ours = line.split_whitespace().next().is_none_or(is_ours);
    assert!(is_ours || trainer.exists(), "{} is missing: cargo build --bin trainer", trainer.display());
    if is_ours { lab.to_owned() } else { trainer }
}
