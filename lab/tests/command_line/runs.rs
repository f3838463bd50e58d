//! Records of real runs, and what `lab runs` shows of them.

use std::collections::BTreeSet;
use std::fs;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::support::{Place, text};

/// Two short trainings and two torture runs.
fn four_runs() -> Place {
    let place = Place::new();
    for seed in [5, 6] {
        place.ok(&format!("torture --breaths 60 --seed {seed} --json out/torture-{seed}.json"));
        place.ok(&format!(
            "train --out out/train-{seed} --rounds 1 --breaths 12 --epochs 4 --iterations 10 --batch 16 --seed {seed}"
        ));
    }
    place
}

fn names(listed: &Value) -> Vec<&str> {
    let runs = listed["runs"].as_array().unwrap();
    runs.iter().map(|run| run["name"].as_str().unwrap()).collect()
}

#[test]
fn every_run_leaves_a_record_of_what_made_it() {
    let place = four_runs();
    let record: Value =
        serde_json::from_str(&fs::read_to_string(place.path("out/train-5/made-by.json")).unwrap()).unwrap();
    assert_eq!((&record["command"][0], &record["ending"]), (&"train".into(), &"complete".into()));
    assert_eq!((&record["options"]["seed"], &record["options"]["bench"]), (&"5".into(), &"R20C20".into()));
    assert!(record["figures"]["validation"].is_number() && record["attempts"] == 1, "{record}");
    assert_eq!(record["curves"]["rounds.0.fit_curve"]["steps"], json!([1, 2, 3, 4]));
    let shown = place.ok("runs out --figure validation --figure peak_true");
    for text in ["train-5", "torture-6", "complete", "validation", "peak_true"] {
        assert!(shown.contains(text), "{text}: {shown}");
    }
    let listed = place.json("runs out --filter train-");
    assert_eq!(names(&listed), ["train-5", "train-6"]);
    assert_eq!(listed["runs"][0]["state"], "complete");
    assert_eq!(names(&place.json("runs out --sort peak_true --filter seed=6")), ["torture-6", "train-6"]);
}

#[test]
fn runs_are_compared_plotted_and_reported() {
    let place = four_runs();
    let found = place.json("runs out --compare train-5 out/train-6");
    let options = found["comparison"]["options"].as_array().unwrap();
    assert_eq!(options[..], [json!({ "name": "seed", "values": ["5", "6"] })]);
    let shown = place.ok("runs out --compare torture-5 torture-6");
    assert!(shown.contains("torture-6, %") && !shown.contains("Different origin"), "{shown}");
    place.ok("runs out --filter train --plot curves.svg --report runs.html");
    place.ok("runs out --figure peak_true --plot peaks.svg --x seed");
    for (file, text) in
        [("curves.svg", "rounds.0.train_curve.validation"), ("peaks.svg", "seed"), ("runs.html", "train-6")]
    {
        assert!(fs::read_to_string(place.path(file)).unwrap().contains(text), "{file}");
    }
    let page = fs::read_to_string(place.path("runs.html")).unwrap();
    assert_eq!(page.matches("Runs").count(), 2, "the title and the heading");
    fs::create_dir(place.path("empty")).unwrap();
    for (line, reason) in [
        ("runs empty", "contains no runs: commands with --out leave a made-by.json"),
        ("runs nowhere", "cannot read nowhere"),
        ("runs out --figure score", "no run has a figure or a curve score: choose among"),
        ("runs out --compare train-5 train-7", "there is no run train-7: choose among"),
        ("runs out --filter seed=7", "no run in out has seed=7"),
    ] {
        assert!(place.refused(line).contains(reason), "{line}");
    }
    fs::create_dir(place.path("damaged")).unwrap();
    fs::write(place.path("damaged/made-by.json"), "{").unwrap();
    let told = place.run("runs damaged");
    let stderr = text(&told.stderr);
    assert_eq!(told.status.code(), Some(1), "{stderr}");
    assert!(stderr.ends_with("error: damaged contains no record of a run that can be read\n"), "{stderr}");
}

#[test]
fn the_runs_of_a_sweep_and_the_tasks_of_shards_have_records() {
    let place = Place::new();
    let text = "command = \"torture --breaths 60\"\nfigures = [\"peak_true\"]\n[options]\nseed = [1, 2]\n";
    fs::write(place.path("sweep.toml"), text).unwrap();
    place.ok("sweep sweep.toml --out sweep");
    // The runs begin at the same time.
    let listed = place.json("runs sweep");
    assert_eq!(BTreeSet::from_iter(names(&listed)), BTreeSet::from([".", "runs/0", "runs/1"]));
    for shard in ["0/2", "1/2"] {
        place.ok(&format!("torture --breaths 60 --out shards --shard {shard}"));
    }
    assert!(place.refused("runs shards").contains("contains no runs"));
    assert_eq!(names(&place.json("runs shards --tasks")), ["shards/0-of-2", "shards/1-of-2"]);
    place.ok("torture --breaths 60 --out shards --merge");
    assert_eq!(names(&place.json("runs shards")), ["."]);
}

#[test]
fn a_refused_command_changes_no_record_and_leaves_none() {
    let place = Place::new();
    let line = "train --out run --rounds 1 --breaths 12 --epochs 4 --iterations 10 --batch 16";
    place.ok(line);
    let record = || fs::read_to_string(place.path("run/made-by.json")).unwrap();
    let first = record();
    place.refused(&format!("{line} --seed 2"));
    assert_eq!(record(), first);
    place.refused("train --out new/run --settings rise_time=0.2");
    assert!(!place.path("new").exists());
    place.ok(line);
    let again: Value = serde_json::from_str(&record()).unwrap();
    let first: Value = serde_json::from_str(&first).unwrap();
    assert_eq!((&again["attempts"], &again["began_s"]), (&2.into(), &first["began_s"]));
}

#[test]
fn a_run_that_was_killed_is_listed_as_killed() {
    let place = Place::new();
    let mut run = place.command("torture --breaths 10000000 --json long.json").spawn().unwrap();
    let begun = Instant::now();
    while !place.path("long.made-by.json").exists() {
        assert!(begun.elapsed() < Duration::from_mins(2), "no record was written");
        std::thread::sleep(Duration::from_millis(20));
    }
    let state = || place.json("runs .")["runs"][0]["state"].clone();
    assert_eq!(state(), "running");
    run.kill().unwrap();
    run.wait().unwrap();
    assert_eq!(state(), "killed");
}
