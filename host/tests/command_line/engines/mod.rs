//! The shards of a command on real engines: Slurm and GNU parallel, as Debian packages them (`.ci/setup/engines` installs them).

mod disk;
mod parallel;
mod slurm;

use std::fs;
use std::path::PathBuf;

use super::support::Place;

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

/// The command to submit, after `--`.
fn submitted(place: &Place) -> String {
    format!("-- {COMMAND} --out run --json {}", merged(place).display())
}
