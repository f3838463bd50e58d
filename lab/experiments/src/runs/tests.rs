//! Tests on made-up records.

use std::fs;
use std::path::Path;

use campaign::record::{Ending, Options, Record, Results};
use serde_json::json;
use tempfile::TempDir;

use super::*;

/// A record of a run with a seed.
fn record(seed: u64, score: f64) -> Record {
    let text = |text: &str| text.to_owned();
    Record {
        command: vec![text("train"), text("--seed"), seed.to_string()],
        options: [
            (text("seed"), seed.to_string()),
            (text("lung"), text("R20C20")),
            (text("out"), seed.to_string()),
        ]
        .into(),
        host: text("laboratory"),
        began_s: 1_000 + seed,
        ended_s: Some(2_000),
        ending: Ending::Complete,
        results: Results::of(&json!({
            "validation": score,
            "base": 2.0,
            "train_curve": [
                { "iteration": 1, "training": 2.0, "validation": 2.0 },
                { "iteration": 5, "training": 1.0, "validation": score },
            ],
        })),
        ..Record::begin(&Options::default())
    }
}

fn save(folder: &Path, file: &str, record: &Record) {
    let file = folder.join(file);
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, serde_json::to_string(record).unwrap()).unwrap();
}

/// A folder with three runs, and a task of a fourth.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    save(folder.path(), "later/made-by.json", &record(10, 1.0));
    save(folder.path(), "sweep/runs/2/made-by.json", &record(2, 1.5));
    save(folder.path(), "sweep/runs/3.made-by.json", &record(3, 3.0));
    save(folder.path(), "robust/shards/0-of-2.task.json", &record(4, 0.0));
    folder
}

fn names(runs: &[Run]) -> Vec<&str> {
    runs.iter().map(|run| run.name.as_str()).collect()
}

#[test]
fn records_are_found_at_any_depth_and_listed_in_the_order_of_time() {
    let folder = folder();
    let runs = find(folder.path(), false).unwrap().runs;
    assert_eq!(names(&runs), ["sweep/runs/2", "sweep/runs/3", "later"]);
    let with_tasks = find(folder.path(), true).unwrap().runs;
    assert_eq!(names(&with_tasks)[2], "robust/shards/0-of-2");
    assert_eq!(names(&find(&folder.path().join("later"), false).unwrap().runs), ["."]);
    fs::write(folder.path().join("later/made-by.json"), "{").unwrap();
    let found = find(folder.path(), false).unwrap();
    assert!(found.runs.len() == 2 && found.damaged[0].contains("later/made-by.json"), "{found:?}");
    let empty = tempfile::tempdir().unwrap();
    assert!(
        find(empty.path(), false).unwrap_err().to_string().contains("contains no runs: commands with --out")
    );
}

#[test]
fn runs_are_sorted_and_chosen_by_figures_options_and_text() {
    let folder = folder();
    let mut runs = find(folder.path(), false).unwrap().runs;
    sort(&mut runs, "validation");
    assert_eq!(names(&runs), ["later", "sweep/runs/2", "sweep/runs/3"]);
    sort(&mut runs, "seed");
    assert_eq!(names(&runs), ["sweep/runs/2", "sweep/runs/3", "later"]);
    let chosen = |text: &str| runs.iter().filter(|run| run.matches(text)).count();
    assert_eq!([chosen("seed=1"), chosen("seed=10"), chosen("sweep"), chosen("laboratory")], [0, 1, 2, 3]);
    let of = |name: &str| {
        named(&runs, folder.path(), name).map(|run| run.name.as_str()).map_err(|e| e.to_string())
    };
    assert_eq!(of("3/").unwrap(), "sweep/runs/3");
    assert_eq!(of(folder.path().join("later").to_str().unwrap()).unwrap(), "later");
    assert!(of("4").unwrap_err().contains("choose among sweep/runs/2, sweep/runs/3, later"));
}

#[test]
fn a_comparison_has_only_what_differs_and_by_how_much() {
    let folder = folder();
    let runs = find(folder.path(), false).unwrap().runs;
    let found = Comparison::of(&runs);
    assert_eq!(found.origin, []);
    let options: Vec<_> = found.options.iter().map(|option| option.name.as_str()).collect();
    assert_eq!(options, ["seed"], "the lung is the same, and where a run writes does not count");
    let figures: Vec<_> = found.figures.iter().map(|figure| figure.name.as_str()).collect();
    assert_eq!(figures, ["train_curve.validation", "validation"]);
    assert_eq!(found.figures[1].values, [Some(1.5), Some(3.0), Some(1.0)]);
    let percent: Vec<_> = found.figures[1].percent.iter().map(|percent| percent.unwrap().round()).collect();
    assert_eq!(percent, [100.0, -33.0]);
}

#[test]
fn figures_are_plotted_by_run_or_against_an_option_and_curves_over_each_other() {
    let folder = folder();
    let runs = find(folder.path(), false).unwrap().runs;
    let plot =
        |names: &[&str], x| plots(&runs, &names.iter().map(ToString::to_string).collect::<Vec<_>>(), x);
    let bars = plot(&["validation"], None).unwrap();
    assert_eq!(bars[0].series[0].points, [(1.0, 1.5), (2.0, 3.0), (3.0, 1.0)]);
    assert!(bars[0].y_range.unwrap().0.abs() < f64::EPSILON, "bars begin at zero");
    let points = plot(&["validation"], Some("seed")).unwrap();
    assert_eq!(points[0].series[0].points, [(2.0, 1.5), (3.0, 3.0), (10.0, 1.0)]);
    let curves = plot(&[], None).unwrap();
    assert_eq!((curves.len(), curves[0].series.len()), (1, 3));
    assert_eq!(curves[0].series[0].points, [(1.0, 2.0), (5.0, 1.5)]);
    assert_eq!(plot(&["train_curve"], None).unwrap().len(), 2);
    let mut rounds = runs.clone();
    let last = rounds[0].record.results.curves.pop_last().unwrap().1;
    rounds[0].record.results.curves.insert("rounds.0.train_curve.validation".into(), last);
    let named = ["train_curve.validation".to_owned()];
    assert_eq!(
        plots(&rounds, &named, None).unwrap().len(),
        2,
        "that of the round and those of the other runs"
    );
    for plot in bars.iter().chain(&points).chain(&curves) {
        plot.to_svg().unwrap();
    }
    let refused = |names: &[&str], x| plot(names, x).unwrap_err().to_string();
    assert!(refused(&["valid"], None).contains("no run has a figure or a curve valid: choose among base"));
    assert!(refused(&["validation"], Some("lung")).contains("choose an option that is a number"));
}
