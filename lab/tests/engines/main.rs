//! The shards of a command on real engines, which `.ci/setup/engines` installs: Slurm and GNU parallel as Debian packages them, and
//! `HyperQueue`.

mod disk;
mod hyperqueue;
mod parallel;
mod slurm;
#[path = "../../../host/tests/command_line/support.rs"]
#[expect(dead_code, reason = "the tests of the command line use the rest")]
mod support;

use std::fs;
use std::path::{Path, PathBuf};

use lab::cli::program::is_ours;
use support::Place;

/// A command of a second or two.
const COMMAND: &str = "torture --breaths 1200 --seed 5";

/// The results of the command as a whole.
fn whole(place: &Place) -> String {
    place.ok(&format!("{COMMAND} --json whole.json"));
    fs::read_to_string(place.path("whole.json")).unwrap()
}

/// Where the merge of a submitted command writes its results: a task may run in any folder.
fn merged(place: &Place) -> PathBuf {
    place.path("merged.json")
}

/// What the task with a shard of `run` has recorded, such as 3-of-7.
fn record(place: &Place, shard: &str) -> serde_json::Value {
    let path = place.path(&format!("run/shards/{shard}.task.json"));
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// The command to submit, after `--`.
fn submitted(place: &Place) -> String {
    format!("-- {COMMAND} --out run --json {}", merged(place).display())
}

/// The program of a command line: the laboratory's or, for a command that it does not have, the trainer beside it.
fn program_of(line: &str) -> PathBuf {
    let lab = Path::new(env!("CARGO_BIN_EXE_lab"));
    let trainer = lab.with_file_name(format!("trainer{}", std::env::consts::EXE_SUFFIX));
    let is_ours = line.split_whitespace().next().is_none_or(is_ours);
    assert!(is_ours || trainer.exists(), "{} is missing: cargo build --bin trainer", trainer.display());
    if is_ours { lab.to_owned() } else { trainer }
}
