//! Ctrl-C keeps the results so far.

use data::recording::Recording;
use learn::simulator::model::Simulator;

use super::support::{INTERRUPTED, Place, text};

#[test]
#[cfg(unix)]
fn an_interrupted_collection_is_a_whole_recording() {
    let place = Place::new();
    let output = place.interrupt("collect --out a.parquet --breaths 20000");
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
    let output = place.interrupt(&format!("fit {data} --out sim.safetensors --epochs 10000000"));
    assert_eq!(output.status.code(), INTERRUPTED, "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("stopped after"), "{}", text(&output.stdout));
    let simulator = Simulator::load(&place.path("sim.safetensors")).unwrap();
    assert!(simulator.parameters.iter().all(|parameter| parameter.is_finite()));
}

#[test]
#[cfg(unix)]
fn a_training_that_is_interrupted_before_its_first_controller_has_stopped() {
    let place = Place::new();
    let output = place.interrupt("train --out a --breaths 10000000");
    assert_eq!(output.status.code(), INTERRUPTED, "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("run the same command again"), "{}", text(&output.stderr));
    let record = std::fs::read_to_string(place.path("a/made-by.json")).unwrap();
    assert!(record.contains("\"stopped\""), "{record}");
}

#[test]
#[cfg(unix)]
fn an_interrupted_search_gives_the_best_so_far() {
    let place = Place::new();
    let output = place.interrupt("tune-pid --bench iso --grid exhaustive --breaths 50 --json -");
    assert_eq!(output.status.code(), INTERRUPTED, "{}", text(&output.stderr));
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(result["complete"], false);
    assert_eq!(result["lungs"].as_array().unwrap().len(), 21);
}
