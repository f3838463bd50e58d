//! `trainer blackbox` with a simulated device at a pseudo-terminal.

use std::fs;
use std::time::Instant;

use plant::bench::{BenchConfig, Failure, FaultConfig, Faulty};
use shared::breath::paper_settings;
use shared::link::messages::Event;
use shared::recorder::{FAST_TAIL, RecorderStatus};
use shared::safety::alarms::Fault;
use shared::settings::Settings;

use super::bedside::{Bedside, LONG};
use super::support::Place;

/// PEEP, above which the pressure stays, cmH2O.
const PEEP: f32 = 5.0;

#[test]
fn a_fault_is_read_drawn_and_cleared() {
    let mut bench = BenchConfig::paper(20.0, 20.0);
    let what = Faulty::Part(Failure::ExpiratoryValveClosed);
    bench.faults.push(FaultConfig { from_s: 7.0, to_s: None, repeats: None, what });
    let bedside = Bedside::at(&bench);
    fail(&bedside);
    let name = bedside.name();

    let place = Place::new();
    let json = place.json(&format!("blackbox --port {name} --out ticks.csv --report page.html"));
    assert_eq!(json["status"]["recording"]["Fault"], "SustainedPressure");
    assert!(
        json["fast"]["entries"].as_array().unwrap().len() > FAST_TAIL as usize,
        "half a second follows the fault"
    );
    let csv = fs::read_to_string(place.path("ticks.csv")).unwrap();
    let mut pressures = csv.lines().skip(1).filter_map(|line| line.split(',').nth(2)?.parse::<f32>().ok());
    assert!(pressures.any(|pressure| pressure > PEEP + 3.0), "the pressure that does not come down is in it");
    assert!(csv.lines().any(|line| line.contains(",fault,")) && csv.contains("inspiration"));
    assert!(fs::read_to_string(place.path("page.html")).unwrap().contains("<svg"));
    let text = place.ok(&format!("blackbox --port {name} --out all.json --clear"));
    assert!(text.contains("fault: pressure does not come down") && text.contains("are cleared"), "{text}");
    let saved: serde_json::Value =
        serde_json::from_slice(&fs::read(place.path("all.json")).unwrap()).unwrap();
    assert_eq!(saved["status"]["recording"], json["status"]["recording"]);
    let after = place.json(&format!("blackbox --port {name}"));
    assert_eq!(
        (&after["status"]["recording"], &after["fast"]["entries"]),
        (&"Nothing".into(), &serde_json::json!([]))
    );
    assert!(after["log"].as_array().unwrap().iter().any(|event| event["happening"] == "Cleared"));
}

/// Makes the device ventilate against its expiratory valve until it is in its safe state and the tail is recorded.
fn fail(bedside: &Bedside) {
    let mut device = bedside.connected();
    device.apply(Settings { peep: PEEP, ..paper_settings(30.0) }).unwrap();
    device.start().unwrap();
    let deadline = Instant::now() + LONG;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let event = device.events().recv_timeout(left).expect("a fault comes");
        if matches!(event, Event::Alarm { fault: Fault::SustainedPressure, .. }) {
            break;
        }
    }
    let ended = |status: &RecorderStatus| status.fast.tick(status.fast.next, 1) == status.tick + FAST_TAIL;
    while !ended(&device.recorder().unwrap()) {
        assert!(Instant::now() < deadline, "the recording never ends");
    }
}

#[test]
fn a_file_of_another_kind_is_refused_before_anything_is_read() {
    let place = Place::new();
    let output = place.run("blackbox --port /dev/nowhere --out ticks.txt");
    assert_eq!(output.status.code(), Some(2));
    assert!(super::support::text(&output.stderr).contains(".csv"));
}
