//! Commissioning at a tiny size, on benches.

use data::recording::Recording;
use learn::controller::learned::Learned;
use shared::weights::decode;

use super::support::Place;

/// Few breaths and gradient steps.
const TINY: &str = "commission --breaths 8 --iterations 4 --pips 15,25 --out run";

/// A bench whose valve is slower than the nominal one's.
fn slower(place: &Place) -> &'static str {
    std::fs::write(place.path("slower.toml"), "name = \"slower\"\n[valve]\nlag_ms = 40.0\n").unwrap();
    "slower.toml"
}

#[test]
fn a_unit_is_commissioned_and_a_second_call_continues_from_its_recording() {
    let place = Place::new();
    let line = format!("{TINY} --bench {}", slower(&place));
    let text = place.ok(&line);
    for expected in
        ["[1/5]", "[5/5]", "lag of the valve", "bench, breaths of learning before: 20", "trainer flash"]
    {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    let recording = Recording::load(place.path("run/recording.parquet")).unwrap();
    assert_eq!((recording.inspirations().len(), recording.provenance.plant.as_str()), (8, "slower"));
    let learned = Learned::load(&place.path("run/controller.safetensors")).unwrap();
    let image = std::fs::read(place.path("run/weights.bin")).unwrap();
    assert_eq!(decode(&image).unwrap().residual, learned.controller);
    assert!(std::fs::read_to_string(place.path("run/report.html")).unwrap().contains("Fine-tuning"));
    let again = place.json(&line);
    assert_eq!(std::fs::read(place.path("run/weights.bin")).unwrap(), image);
    assert_eq!((&again["breaths"], &again["start"]), (&8.into(), &"adult".into()));
    let score = |of: &str| again["simulator"][of].as_f64().unwrap();
    assert!(score("commissioned") <= score("start") && score("start") < score("pid"), "{again}");
    assert_eq!(again["bench"].as_array().unwrap().len(), 3);
    let continued = place.ok(&line);
    assert!(continued.contains("recording.parquet is complete"), "{continued}");
}

#[test]
fn the_folder_of_another_unit_or_seed_is_refused() {
    let place = Place::new();
    place.ok(&format!("{TINY} --bench R50C10"));
    for other in ["--bench R50C20", "--bench R50C10 --seed 2", "--plant tcp:localhost:1"] {
        let refused = place.refused(&format!("{TINY} {other}"));
        assert!(refused.contains("choose another folder"), "{refused}");
    }
}

#[test]
fn a_recording_that_fails_a_check_is_refused_with_what_to_do() {
    let place = Place::new();
    let refused = place
        .refused(&format!("{TINY} --bench R50C10 --pips 35 --collector 60,900 --settings pressure_limit=42"));
    assert!(refused.contains("safe state ended 1 breath(s)"), "{refused}");
    assert!(!place.path("run/weights.bin").exists());
}

#[test]
fn a_controller_that_does_not_exist_is_refused() {
    let place = Place::new();
    let refused = place.refused(&format!("{TINY} --controller nobody"));
    assert!(refused.contains("there is no controller nobody"), "{refused}");
}
