//! Folders that take no files: a full disk and one that is mounted read-only, each a file system of a few kilobytes, in a mount
//! namespace of its own.

use super::COMMAND;
use crate::support::{Place, text};

/// Runs a shard in a folder that is mounted with these options. Returns its error and the files, half written or complete, that it has
/// left.
fn shard_in(mount: &str) -> (String, String) {
    let place = Place::new();
    std::fs::create_dir(place.path("small")).unwrap();
    let script = format!(
        "mount -t tmpfs -o {mount} none small || exit 77; '{}' {COMMAND} --shard 0/2 --out small; status=$?; \
         find small -name '*.tmp' -o -name '0-of-2.json'; exit $status",
        env!("CARGO_BIN_EXE_lab")
    );
    let output =
        place.program("unshare").args(["--map-root-user", "--mount", "sh", "-c", &script]).output().unwrap();
    let refused = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{refused}");
    (refused, text(&output.stdout))
}

#[test]
fn a_full_disk_is_an_error_of_the_shard_and_leaves_nothing_half_written() {
    // The run and the record of the task fit, and no more.
    let (refused, left) = shard_in("size=8k");
    assert!(refused.contains("small/") && refused.contains("No space left on device"), "{refused}");
    assert_eq!(left, "");
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_of_the_shard() {
    let (refused, left) = shard_in("ro");
    assert!(refused.contains("small/") && refused.contains("Read-only file system"), "{refused}");
    assert_eq!(left, "");
}
