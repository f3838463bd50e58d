//! `trainer judge` on a third-party table: the text, the pictures and the exit status.

use std::fmt::Write;
use std::fs;

use super::support::{Place, text};

const MAP: &str = r#"
plant = "third-party ventilator"
[time]
column = "t"
[pressure]
column = "Paw"
[target]
column = "set"
[u_in]
column = "valve"
[u_out]
column = "vent"
[resistance]
value = 20
[compliance]
value = 20
[group]
column = "run"
"#;

/// Two runs of four breaths at 100 Hz, PIP 35, PEEP 10. In the second run breath 6 overshoots by 6 cmH2O; the table ends
/// within breath 7.
fn table() -> String {
    let mut table = "t,Paw,set,valve,vent,run\n".to_owned();
    for row in 0..2 * 1250 - 250 {
        let (run, tick) = (row / 1250, row % 1250);
        let (breath, t) = (4 * run + (tick + 250) / 300 - 1, f64::from((tick + 250) % 300) * 0.01);
        let inspires = tick >= 50 && t < 0.995;
        let overshoot = if breath == 6 && (0.195..0.295).contains(&t) { 6.0 } else { 0.0 };
        let pressure = if inspires {
            (10.0 + 200.0 * t).min(35.0) + overshoot
        } else {
            (35.0 - 100.0 * (t - 1.0)).clamp(10.0, 35.0)
        };
        let pressure = if tick < 50 { 10.0 } else { pressure };
        let (set, valve, vent) = if inspires { (35, 40, 0) } else { (10, 0, 100) };
        writeln!(table, "{:.2},{pressure:.3},{set},{valve},{vent},A:{run}", f64::from(row) * 0.01).unwrap();
    }
    table
}

fn place() -> Place {
    let place = Place::new();
    fs::write(place.path("table.csv"), table()).unwrap();
    fs::write(place.path("map.toml"), MAP).unwrap();
    place
}

#[test]
fn the_verdict_is_printed() {
    let place = place();
    insta::assert_snapshot!(place.ok("judge table.csv --map map.toml --accuracy 2,4 --rise 150"));
}

#[test]
fn the_exit_status_tells_a_violation_from_a_file_that_cannot_be_judged() {
    let place = place();
    let violated = place.run("judge table.csv --map map.toml --overshoot 2");
    assert_eq!(violated.status.code(), Some(3), "{}", text(&violated.stderr));
    assert_eq!(text(&violated.stderr), "error: 1 of 7 judged breaths violate a declared limit\n");
    assert!(text(&violated.stdout).contains(
        "VIOLATED in 1 of 7 breaths judged, unknown in 1 of 8; worst 6.00 in breath 6 of A:1 (R20 C20)"
    ));
    place.ok("judge table.csv --map map.toml --overshoot 6.01");
    assert!(place.refused("judge table.csv").contains("--map"));
    assert!(place.refused("judge absent.csv --map map.toml").contains("absent.csv"));
    for wrong in ["--overshoot=-1", "--accuracy 2", "--worst -1", "--rise NaN"] {
        let line = format!("judge table.csv --map map.toml {wrong}");
        assert_eq!(place.run(&line).status.code(), Some(2), "{line}");
    }
}

#[test]
fn json_has_every_breath_and_whether_the_limits_are_kept() {
    let place = place();
    let verdict = place.json("judge table.csv --map map.toml --accuracy 2,4");
    let file = &verdict["files"][0];
    assert_eq!((&verdict["pass"], &file["file"]), (&true.into(), &"table.csv".into()));
    assert_eq!(file["breaths"].as_array().unwrap().len(), 7);
    assert_eq!(file["unjudged"][0]["reason"], "the recording ends within the inspiration");
    assert_eq!(file["lungs"][0]["iso"]["row"], 4);
    assert_eq!((&file["breaths"][6]["overshoot"], &file["breaths"][6]["number"]), (&6.0.into(), &6.into()));
    let violated = place.run("judge table.csv --map map.toml --overshoot 2 --json -");
    let json: serde_json::Value = serde_json::from_slice(&violated.stdout).unwrap();
    assert_eq!((&json["pass"], violated.status.code()), (&false.into(), Some(3)));
    assert_eq!(json["files"][0]["limits"][0]["violations"][0]["breath"], 6);
}

#[test]
fn each_sore_spot_has_a_picture_of_its_worst_breath() {
    let place = place();
    let out = place.ok("judge table.csv --map map.toml --plots spots");
    assert!(out.contains("saved spots/table-01-A-1-R20-C20-breath-6-overshoot.svg"), "{out}");
    let svg = fs::read_to_string(place.path("spots/table-01-A-1-R20-C20-breath-6-overshoot.svg")).unwrap();
    for words in ["target", "pressure", "overshoot of 6.0 cmH2O", "inspiratory valve", "expiratory valve"] {
        assert!(svg.contains(words), "{words}");
    }
    place.ok("judge table.csv --map map.toml --plots none --worst 0");
    assert!(!place.path("none").exists());
}

#[test]
fn a_cell_that_is_no_number_is_named_and_nothing_is_judged() {
    let place = place();
    let spoiled = table().replacen(",35.000,35,", ",NaN,35,", 1);
    fs::write(place.path("table.csv"), spoiled).unwrap();
    let refused = place.refused("judge table.csv --map map.toml");
    assert!(refused.contains("column `Paw`") && refused.contains("NaN"), "{refused}");
}

#[test]
fn without_set_points_the_rest_is_judged_and_limits_on_errors_are_refused() {
    let place = place();
    let map = MAP.replace("[target]\ncolumn = \"set\"\n", "");
    fs::write(place.path("map.toml"), map).unwrap();
    let out = place.ok("judge table.csv --map map.toml");
    assert!(out.contains("Target: inferred") && out.contains("accuracy unknown"), "{out}");
    assert!(place.refused("judge table.csv --map map.toml --accuracy 2,4").contains("no set-point"));
}

#[test]
fn a_recording_of_ones_own_is_judged_by_the_true_pressure() {
    let place = Place::new();
    let recording = place.collected();
    let out = place.ok(&format!("judge {recording} --worst 1"));
    assert!(out.contains("12 of 12 breaths judged by the true pressure, 1 ms"), "{out}");
    assert!(out.contains("were perturbed to explore"), "{out}");
    let measured = place.ok(&format!("judge {recording} --measured"));
    assert!(measured.contains("judged by the measured pressure"), "{measured}");
}
