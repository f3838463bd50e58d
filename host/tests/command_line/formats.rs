//! Files of other programs: MCAP of recordings and of a watched device, PIRDS there and back.

use std::fs;
use std::path::Path;

use mcap::{MessageStream, Summary};
use serde_json::Value;

use super::support::Place;

/// Number of messages of a topic in a file, which may lack its end.
fn count(file: &Path, topic: &str) -> usize {
    let bytes = fs::read(file).unwrap_or_default();
    let Ok(stream) = MessageStream::new_with_options(&bytes, mcap::read::Options::IgnoreEndMagic.into())
    else {
        return 0;
    };
    stream.map_while(Result::ok).filter(|message| message.channel.topic == topic).count()
}

#[test]
fn a_recording_becomes_mcap() {
    let place = Place::new();
    let data = place.collected();
    let rows = place.json(&format!("inspect {data}"))["ticks"].as_u64().unwrap();
    let exported = place.json(&format!("export {data} --out a.mcap"));
    assert_eq!((&exported["rows"], &exported["messages"]["/pressure"]), (&rows.into(), &rows.into()));
    let bytes = fs::read(place.path("a.mcap")).unwrap();
    let summary = Summary::read(&bytes).unwrap().unwrap();
    assert!(summary.stats.unwrap().message_count >= 3 * rows);
    let found = MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let last = found.filter(|message| message.channel.topic == "/pressure").last().unwrap();
    let last: Value = serde_json::from_slice(&last.data).unwrap();
    assert!(last["true"].is_number(), "the bench knows the true pressure: {last}");
}

#[test]
fn pirds_of_a_recording_is_imported_and_judged() {
    let place = Place::new();
    let data = place.collected();
    let errors = |line: &str| -> Vec<f64> {
        let verdict = place.json(line);
        let breaths = verdict["files"][0]["breaths"].as_array().unwrap();
        breaths.iter().map(|breath| breath["error"].as_f64().unwrap()).collect()
    };
    let expected = errors(&format!("judge {data} --measured"));
    for events in ["a.json", "a.jsonl"] {
        place.ok(&format!("export {data} --out {events}"));
        let summary = place.json(&format!("import {events} --out back.parquet --force"));
        assert_eq!((&summary["complete_breaths"], summary.get("unused")), (&12.into(), None));
        let found = errors("judge back.parquet");
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 0.05, "{found} {expected}");
        }
    }
    assert!(place.refused(&format!("import {data} --out b.parquet")).contains("is a Parquet file"));
    assert!(place.refused("fit back.parquet --out s.safetensors").contains("valve commands"));
}

#[test]
fn an_export_that_cannot_be_made_says_what_to_do() {
    let place = Place::new();
    let data = place.collected();
    assert!(place.refused(&format!("export {data} --out a.xyz")).contains(".mcap, .json, .jsonl"));
    fs::write(place.path("a.txt"), "text").unwrap();
    assert!(place.refused("export a.txt --out a.mcap").contains(".parquet"));
}

#[cfg(unix)]
mod watched {
    //! `trainer monitor --mcap` with a simulated device at a pseudo-terminal.

    use std::process::{Child, Command, Stdio};
    use std::time::{Duration, Instant};

    use plant::bench::BenchConfig;
    use shared::settings::Settings;

    use super::*;
    use crate::bedside::{Bedside, LONG};

    /// Watches a device with JSON at the end in place of lines.
    fn watch(bedside: &Bedside, place: &Place, file: &str) -> Child {
        let line = format!("monitor --port {} --mcap {file} --json -", bedside.name());
        let mut command = place.command(&line);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    /// A device that ventilates.
    fn ventilating() -> Bedside {
        let bedside = Bedside::at(&BenchConfig::paper(20.0, 20.0));
        let mut device = bedside.connected();
        device.apply(Settings::default()).unwrap();
        device.start().unwrap();
        bedside
    }

    /// Waits until a file has this many samples.
    fn wait_for(file: &Path, samples: usize) {
        let deadline = Instant::now() + LONG;
        while count(file, "/pressure") < samples {
            assert!(Instant::now() < deadline, "only {} samples", count(file, "/pressure"));
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    #[test]
    fn ctrl_c_finishes_the_file() {
        let (place, bedside) = (Place::new(), ventilating());
        let file = place.path("night.mcap");
        let child = watch(&bedside, &place, "night.mcap");
        wait_for(&file, 500);
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(130));
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let summary = Summary::read(&fs::read(&file).unwrap()).unwrap().expect("the file is finished");
        let samples = count(&file, "/pressure");
        assert_eq!(report["messages"]["/pressure"], samples);
        assert!(count(&file, "/device") > 0 && summary.stats.unwrap().message_count > 3 * samples as u64);
        let again = place.refused(&format!("monitor --port {} --mcap night.mcap", bedside.name()));
        assert!(again.contains("night.mcap exists"), "{again}");
    }

    #[test]
    fn a_lost_link_keeps_what_came_and_ctrl_c_finishes_the_file() {
        let (place, bedside) = (Place::new(), ventilating());
        let file = place.path("night.mcap");
        let child = watch(&bedside, &place, "night.mcap");
        wait_for(&file, 500);
        drop(bedside);
        let deadline = Instant::now() + LONG;
        while last_state(&fs::read(&file).unwrap()) != Some(false) {
            assert!(Instant::now() < deadline, "no loss is written");
            std::thread::sleep(Duration::from_millis(100));
        }
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        assert_eq!(child.wait_with_output().unwrap().status.code(), Some(130));
        assert!(Summary::read(&fs::read(&file).unwrap()).unwrap().is_some());
    }

    /// Whether the device was connected at the last message about it.
    fn last_state(bytes: &[u8]) -> Option<bool> {
        let stream =
            MessageStream::new_with_options(bytes, mcap::read::Options::IgnoreEndMagic.into()).ok()?;
        let last =
            stream.map_while(Result::ok).filter(|message| message.channel.topic == "/device").last()?;
        serde_json::from_slice::<Value>(&last.data).ok()?["connected"].as_bool()
    }

    #[test]
    fn a_killed_monitor_leaves_a_file_that_can_be_read_up_to_its_last_second() {
        let (place, bedside) = (Place::new(), ventilating());
        let file = place.path("night.mcap");
        let mut child = watch(&bedside, &place, "night.mcap");
        wait_for(&file, 500);
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(Summary::read(&fs::read(&file).unwrap()).is_err(), "the file has no end");
        assert!(count(&file, "/pressure") >= 500);
    }
}
