//! Folders that take no files: a full disk and one that is mounted read-only, each a file system of a few kilobytes, in a mount
//! namespace of its own.

use super::COMMAND;
use crate::support::{Place, text};

/// Runs a shard in a folder that is mounted with these options, beside a program of the shell. Returns its error and the files, half
/// written or complete, that it has left.
fn shard_in(mount: &str, beside: &str) -> (String, String) {
    let place = Place::new();
    std::fs::create_dir(place.path("small")).unwrap();
    let script = format!(
        "mount -t tmpfs -o {mount} none small || exit 77; {beside} '{}' {COMMAND} --shard 0/2 --out small; status=$?; \
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
fn a_disk_without_room_is_an_error_before_the_work() {
    let (refused, left) = shard_in("size=8k", "");
    assert!(refused.contains("small/") && refused.contains("free some space"), "{refused}");
    assert_eq!(left, "");
}

#[test]
fn a_disk_that_fills_during_the_work_is_an_error_of_the_shard_and_leaves_nothing_half_written() {
    // Another program takes what is left as soon as the shard has written the record of its task.
    let filler = "(until [ -s small/shards/0-of-2.task.json ]; do sleep 0.01; done; cat /dev/zero > small/other) 2> full &";
    let (refused, left) = shard_in("size=2m", filler);
    assert!(refused.contains("small/") && refused.contains("No space left on device"), "{refused}");
    assert_eq!(left, "");
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_of_the_shard() {
    let (refused, left) = shard_in("ro", "");
    assert!(refused.contains("small/") && refused.contains("Read-only file system"), "{refused}");
    assert_eq!(left, "");
}
