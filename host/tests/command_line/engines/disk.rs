//! A full disk: a file system of a few kilobytes, in a mount namespace of its own.

use super::COMMAND;
use crate::support::{Place, text};

#[test]
fn a_full_disk_is_an_error_of_the_shard_and_leaves_nothing_half_written() {
    let place = Place::new();
    std::fs::create_dir(place.path("small")).unwrap();
    let script = format!(
        "mount -t tmpfs -o size=8k none small || exit 77; '{}' {COMMAND} --shard 0/2 --out small; status=$?; \
         find small -name '*.tmp' -o -name '0-of-2.json'; exit $status",
        env!("CARGO_BIN_EXE_trainer")
    );
    // The run and the record of the task fit, and no more.
    let output =
        place.program("unshare").args(["--map-root-user", "--mount", "sh", "-c", &script]).output().unwrap();
    let refused = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{refused}");
    assert!(refused.contains("small/") && refused.contains("No space left on device"), "{refused}");
    assert_eq!(text(&output.stdout), "", "files that are left");
}
