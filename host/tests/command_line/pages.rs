//! Pages whose commands run as they are, from the first to the last, in a folder like a clone.

use std::fs;
use std::path::{Path, PathBuf};

use super::support::Place;

fn top() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The commands of a page in their order: the indented lines that call the trainer, without what follows the arguments.
fn commands(page: &str) -> Vec<String> {
    let page = fs::read_to_string(top().join(page)).unwrap();
    let calls = page.lines().filter_map(|line| line.strip_prefix("    cargo trainer "));
    calls.map(|call| call.split('#').next().unwrap_or_default().trim_end().to_owned()).collect()
}

#[test]
fn the_way_from_a_table_of_ones_own_board_to_a_controller_can_be_walked() {
    let place = Place::new();
    let sample = "examples/board";
    fs::create_dir_all(place.path(sample)).unwrap();
    for file in fs::read_dir(top().join(sample)).unwrap() {
        let file = file.unwrap();
        fs::copy(file.path(), place.path(sample).join(file.file_name())).unwrap();
    }
    let commands = commands("docs/YOUR_BOARD.md");
    let names: Vec<&str> = commands.iter().filter_map(|line| line.split(' ').next()).collect();
    assert_eq!(names, ["import", "fit", "train", "export", "evaluate", "judge"]);
    let outputs: Vec<String> = commands.iter().map(|line| place.ok(line)).collect();
    assert!(outputs[0].contains("59 complete") && outputs[0].contains("20 ms"), "{}", outputs[0]);
    // The page says 0.9 for the learned controller, and 5.3 for its PID.
    let mean = |controller: &str| -> f64 {
        let table =
            outputs[4].lines().find(|line| line.contains("mean") && line.contains(controller)).unwrap();
        let score = table.split_whitespace().nth(2).unwrap();
        score.trim_end_matches('*').parse().unwrap()
    };
    assert!(mean("learned") < 1.0 && mean("PID") > 5.0, "{}", outputs[4]);
}
