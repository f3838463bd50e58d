//! `HyperQueue` on this machine: the server and the worker of its Python package, in one process, which ends with its tasks.

use std::fs;
use std::path::Path;

use super::{COMMAND, record, whole};
use crate::support::{Place, text};

/// Python with the package of `HyperQueue`, as `.ci/setup/engines` installs it.
const PYTHON: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/engines/venv/bin/python");
/// Script that starts server and worker, and runs the shards.
const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/engines/cluster.py");

#[test]
fn tasks_of_hyperqueue_equal_the_whole_run_once_they_are_merged() {
    assert!(Path::new(PYTHON).exists(), "there is no {PYTHON}: run .ci/setup/engines");
    let place = Place::new();
    let folder = |name: &str| {
        fs::create_dir(place.path(name)).unwrap();
        place.path(name)
    };
    let mut tasks = place.program("timeout");
    tasks.args(["--kill-after=5", "120", PYTHON, SCRIPT]);
    tasks.arg(folder("server")).args(["7", env!("CARGO_BIN_EXE_lab")]);
    tasks.args(COMMAND.split(' ')).args(["--out", "run"]).env("TMPDIR", folder("temporary"));
    let output = tasks.output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let merged = place.ok(&format!("{COMMAND} --merge --out run --json -"));
    assert_eq!(merged, whole(&place));
    for shard in 0..7 {
        assert_eq!(record(&place, &format!("{shard}-of-7"))["engine"], "HyperQueue");
    }
}
