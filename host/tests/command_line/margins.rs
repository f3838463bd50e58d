//! `trainer margins`, on a bench and on a device at a port.

use device::simulated::{MOST_PACE, Served};
use plant::bench::BenchConfig;

use super::support::Place;

/// A short sweep.
const SHORT: &str = "--frequencies 10 --breaths 5 --gains 4,120,0.1";

#[test]
fn the_margins_of_a_bench_are_stated_with_their_intervals_and_drawn() {
    let place = Place::new();
    let result = place.json(&format!("margins {SHORT} --plot nyquist.svg --report margins.html"));
    let ms = &result["margins"]["ms"]["found"];
    let [low, value, high] = ["low", "value", "high"].map(|end| ms[end].as_f64().unwrap());
    assert!(low < value && value < high && (value - 1.75).abs() < 0.15, "{ms}");
    assert_eq!(result["estimates"].as_array().map(Vec::len), Some(10));
    assert!(result["ended"].is_null() && result["plant"] == "R20C20");
    assert!(std::fs::read_to_string(place.path("nyquist.svg")).unwrap().starts_with("<svg"));
    let page = std::fs::read_to_string(place.path("margins.html")).unwrap();
    assert!(["Magnitude", "Angle", "effort", "Ms"].iter().all(|part| page.contains(part)));
}

#[test]
fn a_loop_near_its_edge_is_advised_to_lower_its_gains() {
    let text = Place::new().ok("margins --gains 4,120,0.1 --bench R50C20 --pip 35 --amplitude 8");
    assert!(text.contains("advice: the gain is too high: Ms is 2."), "{text}");
}

#[test]
fn a_sine_beyond_a_limit_is_refused_with_what_is_allowed() {
    let place = Place::new();
    assert!(place.wrong("margins --amplitude 30").contains("0.1 to 20"));
    let refused = place.refused("margins --pip 10");
    assert!(refused.contains("would reach the valve's limits") && refused.contains("at most"), "{refused}");
    let refused = place.refused("margins --settings inspiratory_time=0.5");
    assert!(refused.contains("too short"), "{refused}");
}

#[test]
fn a_device_is_measured_only_with_a_confirmed_test_lung_and_as_the_bench_is() {
    let place = Place::new();
    let mut bench = BenchConfig::paper(20.0, 20.0);
    // A served device has the airway sensor alone.
    bench.flow_sensor.present = false;
    let served = Served::start(&bench, MOST_PACE).unwrap();
    let line = format!("margins {SHORT} --port {}", served.address());
    assert!(place.refused(&line).contains("no test lung was confirmed"));
    let there = place.json(&format!("{line} --test-lung"));
    std::fs::write(place.path("bench.toml"), bench.to_toml()).unwrap();
    let here = place.json(&format!("margins {SHORT} --bench bench.toml"));
    assert_eq!(there["estimates"], here["estimates"]);
    assert_eq!(there["margins"], here["margins"]);
}
