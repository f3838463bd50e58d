//! Pages whose commands run as they are, from the first to the last, in a folder like a clone.

use std::fs;
use std::path::{Path, PathBuf};

use super::support::{Place, text};

fn top() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A command of a page.
struct Step {
    /// Its arguments.
    line: String,
    /// The exit status that the page announces, as in `# status 3`; otherwise 0.
    status: i32,
}

/// The commands of a page in their order: the indented lines that call the trainer.
fn steps(page: &str) -> Vec<Step> {
    let page = fs::read_to_string(top().join(page)).unwrap();
    let calls = page.lines().filter_map(|line| line.strip_prefix("    cargo trainer "));
    let step = |call: &str| {
        let (line, remark) = call.split_once('#').unwrap_or((call, ""));
        let status = remark.trim().strip_prefix("status ").map_or(0, |status| status.parse().unwrap());
        Step { line: line.trim_end().to_owned(), status }
    };
    calls.map(step).collect()
}

/// A folder with these samples of a clone.
fn clone_with(sample: &str) -> Place {
    let place = Place::new();
    fs::create_dir_all(place.path(sample)).unwrap();
    for file in fs::read_dir(top().join(sample)).unwrap() {
        let file = file.unwrap();
        fs::copy(file.path(), place.path(sample).join(file.file_name())).unwrap();
    }
    place
}

/// Runs the commands of a page, which are these; returns what each prints.
fn walk(place: &Place, page: &str, commands: &[&str]) -> Vec<String> {
    let steps = steps(page);
    let names: Vec<&str> = steps.iter().filter_map(|step| step.line.split(' ').next()).collect();
    assert_eq!(names, commands, "{page}");
    let run = |step: &Step| {
        let output = place.run(&step.line);
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(step.status), "{page}: {}: {stderr}", step.line);
        assert!(step.status != 0 || stderr.is_empty(), "{page}: {}: {stderr}", step.line);
        text(&output.stdout)
    };
    steps.iter().map(run).collect()
}

/// The words of the first line with all of these parts.
fn row<'a>(output: &'a str, parts: &[&str]) -> Vec<&'a str> {
    let line = output.lines().find(|line| parts.iter().all(|part| line.contains(part)));
    line.unwrap_or_else(|| panic!("{parts:?}: {output}")).split_whitespace().collect()
}

fn number(word: &str) -> f64 {
    word.trim_end_matches('*').parse().unwrap()
}

#[test]
fn the_way_from_a_table_of_ones_own_board_to_a_controller_can_be_walked() {
    let place = clone_with("examples/board");
    let commands = ["import", "fit", "train", "export", "evaluate", "judge"];
    let outputs = walk(&place, "docs/YOUR_BOARD.md", &commands);
    assert!(outputs[0].contains("59 complete") && outputs[0].contains("20 ms"), "{}", outputs[0]);
    // The page says 0.9 for the learned controller, and 5.3 for its PID.
    let mean = |controller: &str| number(row(&outputs[4], &["mean", controller])[2]);
    assert!(mean("learned") < 1.0 && mean("PID") > 5.0, "{}", outputs[4]);
}

#[test]
fn the_way_from_recordings_to_their_lungs_and_a_simulator_can_be_walked() {
    let place = clone_with("examples/recordings");
    let commands = ["import", "judge", "identify", "identify", "evaluate", "fit", "export", "import"];
    let outputs = walk(&place, "docs/RECORDINGS.md", &commands);
    assert!(outputs[0].contains("18 complete") && outputs[7].contains("18 complete"), "{}", outputs[0]);
    // The lung of the first run has C 20 mL/cmH2O.
    let (_, lung_alone) = outputs[3].split_once("behind the circuit").unwrap();
    let compliance = number(row(lung_alone, &["A:1"])[2]);
    assert!((compliance - 20.0).abs() < 1.0, "{}", outputs[3]);
    // The page says 1.3.
    let held_out = number(row(&outputs[5], &["all"])[3]);
    assert!((held_out - 1.3).abs() < 0.1, "{}", outputs[5]);
}

#[test]
fn the_page_on_verdicts_can_be_walked() {
    let place = clone_with("examples/recordings");
    let outputs = walk(&place, "docs/JUDGE.md", &["judge", "judge", "collect", "judge", "margins"]);
    assert!(place.path("out/judge/sore-spots").is_dir() && place.path("out/judge/verdict.json").is_file());
    // Three lungs at two PIPs, then one lung at one PIP.
    let reports = |output: &str| output.lines().filter(|line| line.contains("  5.0  ")).count();
    assert_eq!((reports(&outputs[0]), reports(&outputs[3])), (6, 1), "{}\n{}", outputs[0], outputs[3]);
    // On the held bench it is 1.78.
    let peak = number(row(&outputs[4], &["Ms"])[1]);
    assert!((peak - 1.78).abs() < 0.1 && place.path("out/margins.html").is_file(), "{}", outputs[4]);
    assert!(outputs.iter().all(|output| output.lines().count() < 80), "a page shows short answers first");
}
