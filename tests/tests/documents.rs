//! Checks that the paths in the documents exist.

use std::fs;
use std::path::{Path, PathBuf};

/// Top-level folders; a quoted word that starts with one of them is a path.
const FOLDERS: [&str; 10] =
    [".ci/", "docs/", "examples/", "firmware/", "fuzz/", "host/", "lab/", "shared/", "tests/", "xtask/"];

fn top() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// All documents, at the top level and in `docs`.
fn documents() -> Vec<PathBuf> {
    let entries =
        [top(), top().join("docs")].into_iter().flat_map(|folder| fs::read_dir(folder).expect("it is there"));
    let paths = entries.map(|entry| entry.expect("it can be read").path());
    paths.filter(|path| path.extension().is_some_and(|extension| extension == "md")).collect()
}

/// Paths of the repository in a text: words in backquotes that start with a top-level folder, except patterns (`<target>`,
/// `*`).
fn named_paths(text: &str) -> Vec<&str> {
    let quoted = text.split('`').skip(1).step_by(2);
    quoted
        .filter(|word| FOLDERS.iter().any(|folder| word.starts_with(folder)))
        .filter(|word| !word.contains([' ', '<', '*', '\n']))
        .map(|word| word.split("::").next().unwrap_or(word))
        .collect()
}

#[test]
fn every_path_in_the_documents_exists() {
    let mut count = 0;
    for document in documents() {
        let text = fs::read_to_string(&document).expect("a document can be read");
        for path in named_paths(&text) {
            count += 1;
            assert!(top().join(path).exists(), "{} names {path}, which does not exist", document.display());
        }
    }
    assert!(count > 50, "too few paths found in the documents: {count}");
}

#[test]
fn paths_are_distinguished_from_commands_and_patterns() {
    let text = "See `host/src/lib.rs` and `docs/LINK.md::x`, not `cargo xtask ci`, `out/demo` or `fuzz/seeds/<target>`.";
    assert_eq!(named_paths(text), ["host/src/lib.rs", "docs/LINK.md"]);
}

/// After a reset the debug port owns these pins, and pulls some of them up, so they cannot keep a valve safe.
#[test]
fn no_board_drives_a_valve_from_the_debug_port() {
    const DEBUG_PORT: [&str; 5] = ["PA13", "PA14", "PA15", "PB3", "PB4"];
    let boards = top().join("firmware/src/chip/board");
    let mut valves = 0;
    for file in fs::read_dir(boards).unwrap() {
        let text = fs::read_to_string(file.unwrap().path()).unwrap();
        let types = text.lines().filter_map(|line| line.strip_prefix("pub type ")?.split_once(" = "));
        for (valve, pin) in types.filter(|(name, _)| ["Inspiratory", "Expiratory"].contains(name)) {
            let pin = pin.trim_end_matches(';');
            assert!(!DEBUG_PORT.contains(&pin), "{valve} is on {pin}");
            valves += 1;
        }
    }
    assert_eq!(valves, 4, "two on each board");
}
