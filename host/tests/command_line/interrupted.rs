//! Ctrl-C keeps the results so far.

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Output, Stdio};

use data::files::read_json;
use data::recording::Recording;
use learn::simulator::model::Simulator;

use super::support::{Place, text};

/// Exit code of a command that Ctrl-C ended.
const INTERRUPTED: Option<i32> = Some(130);

/// Starts a command that would take hours, presses Ctrl-C at its first logged progress, and waits for the end.
fn interrupt(place: &Place, line: &str) -> Output {
    let mut command = place.command(line);
    command.env("EUPNEA_LOG", "debug");
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    let mut stderr = Vec::new();
    log.read_until(b'\n', &mut stderr).unwrap();
    let id = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    // Read in parallel with standard output: a full pipe without a reader would block the program.
    let log = std::thread::spawn(move || {
        log.read_to_end(&mut stderr).unwrap();
        stderr
    });
    let output = child.wait_with_output().unwrap();
    Output { stderr: log.join().unwrap(), ..output }
}

#[test]
#[cfg(unix)]
fn an_interrupted_collection_is_a_whole_recording() {
    let place = Place::new();
    let output = interrupt(&place, "collect --out a.parquet --breaths 10000000");
    assert_eq!(output.status.code(), INTERRUPTED, "{}", text(&output.stderr));
    let recording = Recording::load(place.path("a.parquet")).unwrap();
    let breaths = recording.breaths().len();
    assert!(breaths > 0 && breaths == recording.inspirations().len(), "{breaths}");
}

#[test]
#[cfg(unix)]
fn an_interrupted_fit_saves_the_simulator() {
    let place = Place::new();
    let data = place.collected();
    let output = interrupt(&place, &format!("fit --data {data} --out sim.safetensors --epochs 10000000"));
    assert_eq!(output.status.code(), INTERRUPTED, "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("stopped after"), "{}", text(&output.stdout));
    let simulator = Simulator::load(&place.path("sim.safetensors")).unwrap();
    assert!(simulator.parameters.iter().all(|parameter| parameter.is_finite()));
}

#[test]
#[cfg(unix)]
fn an_interrupted_search_gives_the_best_so_far() {
    let place = Place::new();
    let output = interrupt(&place, "tune-pid --lung iso --exhaustive --breaths 50 --json -");
    assert_eq!(output.status.code(), INTERRUPTED, "{}", text(&output.stderr));
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(result["complete"], false);
    assert_eq!(result["lungs"].as_array().unwrap().len(), 21);
}

#[test]
#[cfg(unix)]
fn an_interrupted_endurance_test_continues() {
    let place = Place::new();
    let line = "endure --hours 0.02 --keep kept.json";
    let output = interrupt(&place, &format!("{line} --patients 1000000"));
    assert!(text(&output.stdout).contains("stopped; if started with --keep"), "{}", text(&output.stdout));
    let kept = || -> Vec<serde_json::Value> {
        let campaign: serde_json::Value = read_json(&place.path("kept.json")).unwrap().unwrap();
        campaign["sums"].as_array().unwrap().clone()
    };
    let before = kept();
    // Those that ended need not be the first ones.
    let patients = before.last().map_or(2, |last| last["patient"].as_u64().unwrap() as usize + 2);
    place.run(&format!("{line} --patients {patients}"));
    let after = kept();
    assert_eq!(after.len(), patients);
    assert!(before.iter().all(|result| after.contains(result)));
}

#[test]
#[cfg(unix)]
fn an_interrupted_measurement_of_margins_ends_soon() {
    let place = Place::new();
    let output = interrupt(&place, "margins --family adult --plants 5000");
    assert_eq!(output.status.code(), INTERRUPTED, "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("stopped"), "{}", text(&output.stdout));
}
