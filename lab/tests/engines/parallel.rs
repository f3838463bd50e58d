//! GNU parallel on this machine.

use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use super::{COMMAND, merged, record, submitted, whole};
use crate::support::{Place, text};

#[test]
fn tasks_of_gnu_parallel_and_their_merge_equal_the_whole_run() {
    let place = Place::new();
    let submitted = submitted(&place);
    let shown = place.ok(&format!("submit parallel --shards 7 --jobs 2 {submitted}"));
    assert!(shown.contains("highest true airway pressure"), "{shown}");
    assert_eq!(fs::read_to_string(merged(&place)).unwrap(), whole(&place));
    assert_eq!(record(&place, "3-of-7")["engine"], "GNU parallel");
    // Only what is missing is run again.
    fs::remove_file(place.path("run/shards/3-of-7.json")).unwrap();
    place.ok(&format!("submit parallel --shards 7 --jobs 2 {submitted}"));
    let attempts = |shard: u64| record(&place, &format!("{shard}-of-7"))["attempts"].clone();
    assert_eq!((attempts(3), attempts(2)), (2.into(), 1.into()));
}

#[test]
fn a_task_uses_its_share_of_the_cores_or_the_number_of_threads_that_the_user_has_set() {
    let cores = std::thread::available_parallelism().unwrap().get();
    for (own, expected) in [(None, (cores / 2).max(1)), (Some("3"), 3)] {
        let place = Place::new();
        let line = format!("submit parallel --shards 2 --jobs 2 {}", submitted(&place));
        let mut command = place.command(&line);
        command.env_remove("RAYON_NUM_THREADS").envs(own.map(|own| ("RAYON_NUM_THREADS", own)));
        assert!(command.output().unwrap().status.success());
        assert_eq!(record(&place, "0-of-2")["threads"], expected);
    }
}

#[test]
fn a_shard_that_cannot_succeed_is_named() {
    let place = Place::new();
    place.ok("torture --breaths 60 --seed 6 --shard 0/2 --out run");
    let output = place.run(&format!("submit parallel --shards 2 --retries 0 {}", submitted(&place)));
    let refused = text(&output.stderr);
    assert!(!output.status.success() && refused.contains("shard 1 has not begun"), "{refused}");
    let log = fs::read_to_string(place.path("run/log/tasks.txt")).unwrap();
    assert!(log.contains("there and"), "{log}");
    assert!(!merged(&place).exists());
}

#[test]
fn ctrl_c_ends_the_tasks_once_they_have_saved_and_the_same_command_continues() {
    let place = Place::new();
    let long = COMMAND.replace("1200", "12000");
    let line = format!(
        "submit parallel --shards 2 --jobs 2 -- {long} --out run --json {}",
        merged(&place).display()
    );
    let submitted = place.command(&line).stdout(Stdio::piped()).spawn().unwrap();
    let part = place.path("run/shards/0-of-2.part.json");
    let begun = Instant::now();
    while !part.exists() {
        assert!(begun.elapsed() < Duration::from_mins(2), "no task has saved anything");
        std::thread::sleep(Duration::from_millis(50));
    }
    Command::new("kill").arg("-INT").arg(submitted.id().to_string()).status().unwrap();
    let output = submitted.wait_with_output().unwrap();
    assert!(text(&output.stdout).contains("stopped"), "{}", text(&output.stdout));
    assert_eq!(record(&place, "0-of-2")["ending"], "stopped", "the task ended by itself");
    place.ok(&line);
    assert_eq!(fs::read_to_string(merged(&place)).unwrap(), place.ok(&format!("{long} --json -")));
}
