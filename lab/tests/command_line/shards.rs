//! Commands whose work is divided among tasks: real processes, some of which are killed.

use std::fs;
use std::time::{Duration, Instant};

use super::support::{Place, text};

/// Commands with a few more units of work than shards.
const COMMANDS: [&str; 4] = [
    "tune-pid --bench R20C20 --bench R5C50 --bench R50C10 --grid coarse --breaths 1 --pips 15",
    "torture --breaths 200 --seed 5",
    "endure --patients 9 --hours 0.01 --seed 2",
    "robust --family short.toml --plants 9 --breaths 3 --subset 1 --gains 2,80,0.1 --seed 4",
];

/// The JSON of a command, whatever its verdict.
fn json(place: &Place, line: &str) -> String {
    let output = place.run(&format!("{line} --json result.json"));
    fs::read_to_string(place.path("result.json"))
        .unwrap_or_else(|_| panic!("{line}: {}", text(&output.stderr)))
}

#[test]
fn merged_shards_equal_the_whole_run_byte_for_byte() {
    let place = Place::new();
    place.write_short_family();
    for line in COMMANDS {
        let whole = json(&place, line);
        for shards in [1, 2, 7] {
            let out = format!("{}-{shards}", &line[..4]);
            for index in (0..shards).rev() {
                let shown = place.ok(&format!("{line} --shard {index}/{shards} --out {out}"));
                assert!(shown.contains("is complete"), "{shown}");
            }
            let _ = fs::remove_file(place.path("result.json"));
            let merged = json(&place, &format!("{line} --merge --out {out}"));
            assert!(merged == whole, "{line} in {shards} shards differs");
        }
    }
}

#[test]
fn a_shard_that_is_killed_continues_and_ends_like_any_other() {
    let place = Place::new();
    let line = "torture --breaths 4500 --seed 5";
    let whole = json(&place, line);
    let part = place.path("killed/shards/0-of-2.part.json");
    // On one thread, so that it still has work when it saves for the first time, on any machine.
    let mut task = place.command(&format!("{line} --shard 0/2 --out killed"));
    let mut task = task.env("RAYON_NUM_THREADS", "1").spawn().unwrap();
    let begun = Instant::now();
    while !part.exists() {
        assert!(begun.elapsed() < Duration::from_mins(2), "the task has saved nothing");
        std::thread::sleep(Duration::from_millis(20));
    }
    task.kill().unwrap();
    task.wait().unwrap();
    let kept: serde_json::Value = serde_json::from_str(&fs::read_to_string(&part).unwrap()).unwrap();
    assert!(kept["done"][0][1].as_u64().unwrap() > 0, "{kept}");
    for shard in ["0/2", "1/2"] {
        place.ok(&format!("{line} --shard {shard} --out killed"));
    }
    assert_eq!(json(&place, &format!("{line} --merge --out killed")), whole);
}

#[test]
fn the_pid_of_a_family_without_one_is_searched_by_the_first_task_and_read_by_the_rest() {
    let place = Place::new();
    // Short breaths, for a short search.
    let family = "name = \"soft\"\npips = [15]\n[settings]\nrate = 80\ninspiratory_time = 0.2\nfall_time = 0.1\n\
                  [family.lung.first]\ncompliance_ml_per_cmh2o = { uniform = [40, 60] }\n";
    fs::write(place.path("soft.toml"), family).unwrap();
    let line = "robust --family soft.toml --plants 4 --breaths 1 --subset 0 --gains 5,200,0.1";
    place.ok(&format!("{line} --shard 0/2 --out out"));
    // A task that searched by itself would not notice other gains.
    let kept = place.path("out/shards/family-pid.json");
    let mut found: serde_json::Value = serde_json::from_str(&fs::read_to_string(&kept).unwrap()).unwrap();
    found["value"]["p"] = 1.5.into();
    fs::write(&kept, found.to_string()).unwrap();
    let refused = place.refused(&format!("{line} --shard 0/2 --out out"));
    assert!(refused.contains("and 1.5 here"), "{refused}");
}

#[test]
fn an_engine_tells_its_tasks_which_shard_they_are() {
    let place = Place::new();
    let line = "torture --breaths 60 --seed 5";
    let task = |arguments: &str, variables: &[(&str, &str)]| {
        let mut command = place.command(&format!("{line} --out out {arguments}"));
        let output = command.envs(variables.iter().copied()).output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let slurm = [
        ("SLURM_ARRAY_TASK_ID", "1"),
        ("SLURM_ARRAY_TASK_MIN", "1"),
        ("SLURM_ARRAY_TASK_MAX", "4"),
        ("SLURM_ARRAY_TASK_COUNT", "4"),
    ];
    assert!(task("", &slurm).contains("shard 1/4"));
    assert!(task("--shard auto/4", &[("HQ_TASK_ID", "2")]).contains("shard 2/4"));
    assert!(task("--shard auto/4", &[("PARALLEL_SEQ", "4")]).contains("shard 0/4"));
    let batch = [("AWS_BATCH_JOB_ARRAY_INDEX", "3"), ("AWS_BATCH_JOB_ARRAY_SIZE", "4")];
    assert!(task("", &batch).contains("shard 3/4"));
    assert_eq!(json(&place, &format!("{line} --merge --out out")), json(&place, line));
    let record = fs::read_to_string(place.path("out/shards/2-of-4.task.json")).unwrap();
    assert!(record.contains("\"engine\": \"HyperQueue\"") && record.contains("complete"), "{record}");
}

#[test]
fn a_sweep_runs_every_combination_and_its_shards_equal_the_whole() {
    let place = Place::new();
    let describe = |command: &str, figures: &str| {
        let options = "seed = [5, 6]\nlimit = [40, 60]";
        let text = format!("command = \"{command}\"\nfigures = {figures}\n[options]\n{options}\n");
        fs::write(place.path("sweep.toml"), text).unwrap();
    };
    describe("torture --breaths 100", "[\"peak_true\", \"latched\"]");
    let whole = json(&place, "sweep sweep.toml --out whole");
    for shard in ["1/2", "0/2"] {
        place.ok(&format!("sweep sweep.toml --out parts --shard {shard}"));
    }
    assert_eq!(json(&place, "sweep sweep.toml --out parts --merge"), whole);
    let found: serde_json::Value = serde_json::from_str(&whole).unwrap();
    assert_eq!(found["runs"].as_array().unwrap().len(), 4);
    assert_eq!(found["runs"][3]["options"], serde_json::json!({ "limit": 60, "seed": 6 }));
    let single: serde_json::Value =
        serde_json::from_str(&json(&place, "torture --breaths 100 --limit 60 --seed 6")).unwrap();
    assert_eq!(found["runs"][3]["figures"][0], single["peak_true"]);
    describe("torture --breths 100", "[\"peak_true\"]");
    assert!(place.refused("sweep sweep.toml --out wrong").contains("(limit 40, seed 5) failed"));
    describe("torture --breaths 100", "[\"peak\"]");
    assert!(place.refused("sweep sweep.toml --out other").contains("gave no number peak"));
}

#[test]
fn what_cannot_be_merged_or_run_is_named_and_nothing_is_written() {
    let place = Place::new();
    let line = "torture --breaths 60 --seed 5";
    let refused = |arguments: &str| place.refused(&format!("{line} {arguments}"));
    assert!(refused("--out out").contains("give --shard i/n"));
    assert!(refused("--merge --out out --json r.json").contains("contains no sharded run"));
    place.ok(&format!("{line} --shard 1/3 --out out"));
    assert!(refused("--merge --out out --json r.json").contains("shards 0, 2 of 3 are not complete"));
    assert!(refused("--shard 0/4 --out out").contains("`shards` is 3 there and 4 here"));
    let other = place.refused("torture --breaths 60 --seed 6 --shard 0/3 --out out");
    assert!(other.contains("`seed` is 5 there and 6 here"), "{other}");
    assert!(!place.path("r.json").exists());
    fs::write(place.path("file"), "no folder").unwrap();
    assert!(refused("--shard 0/3 --out file").contains("file"));
}
