//! Ctrl-C keeps the results so far.

use data::files::read_json;

use super::support::{INTERRUPTED, Place, text};

#[test]
#[cfg(unix)]
fn an_interrupted_endurance_test_continues() {
    let place = Place::new();
    let line = "endure --hours 0.02 --keep kept.json";
    let output = place.interrupt(&format!("{line} --patients 1000000"));
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
    let output = place.interrupt("margins --family adult --plants 5000");
    assert_eq!(output.status.code(), INTERRUPTED, "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("stopped"), "{}", text(&output.stdout));
}
