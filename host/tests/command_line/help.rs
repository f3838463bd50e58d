//! The texts of `--help`, word by word.

use super::support::Place;

#[test]
fn every_command_explains_itself() {
    let place = Place::new();
    for command in [
        "demo",
        "train",
        "train-family",
        "commission",
        "farm",
        "collect",
        "tune-pid",
        "fit",
        "evaluate",
        "export",
        "inspect",
        "import",
        "judge",
        "identify",
        "monitor",
        "serve",
        "selftest",
        "blackbox",
        "keys",
        "flash",
        "qemu",
    ] {
        let help = place.ok(&format!("{command} --help"));
        assert!(help.contains("Examples:"), "{command}");
        insta::assert_snapshot!(command, help);
    }
}

#[test]
fn a_wrong_flag_is_a_usage_error() {
    let place = Place::new();
    let output = place.run("collect --out a.parquet --breath 3");
    assert_eq!(output.status.code(), Some(2));
    assert!(super::support::text(&output.stderr).contains("--breaths"), "it suggests the right one");
}

/// The examples in the help of commands that need no file, at the same size or smaller.
#[test]
fn examples_work() {
    let place = Place::new();
    place.ok("collect --out stiff.parquet --bench R50C10 --gains 2,30 --exploration boundary_probability=0.3 --breaths 6");
    place.ok(
        "collect --out slow.parquet --period-us 30000 --pips 15,25 --exploration triangle_height=-20:20 --breaths 30",
    );
    place.ok("fit slow.parquet --out paper.safetensors --architecture stitched --epochs 2");
    place.ok("evaluate --gains 2,30,0.01 --bench R5C50 --pips 15 --breaths 1");
    let bench = place.ok("inspect --bench R20C20");
    std::fs::write(place.path("bench.toml"), bench).unwrap();
    place.ok("evaluate --bench bench.toml --pips 15 --breaths 1");
}
