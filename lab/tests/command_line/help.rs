//! The texts of `--help`, word by word.

use super::support::{Place, text};

#[test]
fn every_command_explains_itself() {
    let place = Place::new();
    for command in [
        "evaluate",
        "robust",
        "bound",
        "margins",
        "margins-in-breaths",
        "test-table",
        "tune-rival",
        "faults",
        "torture",
        "endure",
        "reproduce",
        "sweep",
        "submit",
        "runs",
        "completions",
    ] {
        let help = place.ok(&format!("{command} --help"));
        assert!(help.contains("Examples:"), "{command}");
        insta::assert_snapshot!(command, help);
    }
    let help = place.program(env!("CARGO_BIN_EXE_lab")).arg("--help").env("COLUMNS", "100").output().unwrap();
    insta::assert_snapshot!("lab", text(&help.stdout));
}
