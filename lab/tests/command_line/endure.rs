//! The endurance test at a tiny size. Whether a device passes is not the question here.

use super::support::{Place, text};

/// Runs an endurance test, whatever its result; returns the JSON.
fn endured(place: &Place, line: &str) -> serde_json::Value {
    let output = place.run(&format!("endure --hours 0.02 --json - {line}"));
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {}", text(&output.stderr)))
}

#[test]
fn the_json_has_the_fixed_fields_and_the_same_numbers_for_the_same_seed() {
    let place = Place::new();
    let result = endured(&place, "--patients 3 --seed 2");
    for field in [
        "breaths",
        "interruptions",
        "high_alarms_undeserved",
        "medium_alarms_undeserved_per_day",
        "alarms_missed",
        "longest_gap_s",
        "peak_true",
    ] {
        assert!(result[field].is_number(), "{field}");
    }
    assert!(result["breaths"].as_u64().unwrap() > 30);
    assert_eq!(result, endured(&place, "--patients 3 --seed 2"));
    assert_ne!(result, endured(&place, "--patients 3 --seed 3"));
}

#[test]
fn one_patient_of_many_runs_again_and_is_described() {
    let place = Place::new();
    let all = ["--patients 1", "--patients 2"].map(|line| endured(&place, line)["breaths"].as_u64().unwrap());
    let second = endured(&place, "--patient 1")["breaths"].as_u64().unwrap();
    assert_eq!(all[1] - all[0], second);
    let output = place.run("endure --hours 0.02 --patient 1");
    assert!(text(&output.stdout).starts_with("patient 1: R "), "{}", text(&output.stdout));
}

#[test]
fn a_learned_controller_ventilates_too() {
    let place = Place::new();
    let controller = place.controller();
    let learned = endured(&place, &format!("--patients 2 --controller {controller} --keep kept.json"));
    assert!(learned["breaths"].as_u64().unwrap() > 20);
    let refused = place.refused("endure --hours 0.02 --patients 2 --keep kept.json");
    assert!(refused.contains("`controller` is"), "{refused}");
    assert!(place.refused("endure --controller absent.safetensors").contains("absent.safetensors"));
}
