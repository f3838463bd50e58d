//! The robustness test at a tiny size.

use super::support::{Place, text};

#[test]
fn the_json_has_the_fixed_fields_with_a_value_for_every_scored_breath() {
    let place = Place::new();
    place.write_short_family();
    let line = "robust --family short.toml --plants 3 --breaths 6 --subset 1 --gains 2,80,0.1 --seed 4";
    let result = place.json(&format!("{line} --plots figures --save-worst worst"));
    assert_eq!(result["plants"], 3);
    assert_eq!(result["breaths"], serde_json::json!([1, 6]));
    for field in [
        "mean",
        "family_pid",
        "share_not_worse",
        "own_not_worse",
        "bound_ratio",
        "overshoot_median",
        "overshoot_p99",
    ] {
        let values = result[field].as_array().unwrap_or_else(|| panic!("{field}"));
        assert!(values.len() == 2 && values.iter().all(serde_json::Value::is_number), "{field}: {values:?}");
    }
    for field in ["effort", "family_effort"] {
        assert!(result[field][1]["total_variation"].as_f64().unwrap() > 0.0, "{field}");
        assert!(result[field][1]["deviation"].as_f64().unwrap() > 0.0, "{field}");
    }
    assert!(result["worsened"].is_number());
    assert_eq!(result["mean_by_breath"].as_array().unwrap().len(), 6);
    for figure in ["ratios.svg", "breaths.svg"] {
        assert!(std::fs::read_to_string(place.path("figures").join(figure)).unwrap().contains("<svg"));
    }
    let worst = result["worst"][0]["number"].as_u64().unwrap();
    place.ok(&format!("evaluate --bench worst/short-{worst}.toml --pips 15 --breaths 1"));
    assert_eq!(result, place.json(&format!("{line} --keep kept.json")), "kept or not");
    assert_eq!(result, place.json(&format!("{line} --keep kept.json")), "nothing is left to do");
}

#[test]
fn twenty_breaths_without_a_subset_leave_out_what_needs_a_search() {
    let place = Place::new();
    let result = place.json("robust --plants 1 --subset 0");
    assert_eq!(result["breaths"], serde_json::json!([1, 6, 20]));
    assert_eq!(result["own_not_worse"], serde_json::json!([null, null, null]));
}

#[test]
fn a_family_that_does_not_exist_is_refused() {
    let refusal = Place::new().refused("robust --family aliens");
    assert!(refusal.contains("there is no family aliens"), "{refusal}");
}

#[test]
fn plants_get_prescriptions_of_their_own_beside_the_pid_that_is_best_for_them() {
    let place = Place::new();
    let line = "robust --prescriptions bedside --plants 4 --breaths 2 --subset 0 --gains 3,60,0.1";
    let result = place.json(&format!("{line} --keep kept.json"));
    assert_eq!(result["prescriptions"], "bedside");
    assert!(result["mean"][0].as_f64().unwrap() > 0.0 && result["cut"].is_number());
    let other = place.refused("robust --plants 4 --breaths 2 --subset 0 --gains 3,60,0.1 --keep kept.json");
    assert!(other.contains("kept.json"), "other prescriptions are another question: {other}");
    let refused = place.refused("robust --plants 1 --prescriptions aliens");
    assert!(refused.contains("there are no prescriptions aliens"), "{refused}");
}

#[test]
fn prescriptions_of_a_bench_are_bounded_one_by_one_and_exclude_pips() {
    let place = Place::new();
    let line = "[drawn]\ndriving_pressure = { uniform = [5, 20] }\ninspiratory_time = { uniform = [0.4, 0.45] }\n\
                [settings]\nfall_time = 0\n";
    std::fs::write(place.path("short.toml"), line).unwrap();
    let result = place.json("bound --bench R5C10 --prescriptions short.toml --period-us 20000");
    let waveforms = result["lungs"][0]["waveforms"].as_array().unwrap();
    assert_eq!(waveforms.len(), 24);
    assert!(waveforms.iter().all(|one| one["score"].as_f64().unwrap() > 0.0 && one["settings"].is_object()));
    for other in ["--pips 15", "--settings peep=8", "--breathing"] {
        let output = place.run(&format!("bound --prescriptions bedside {other}"));
        assert_eq!(output.status.code(), Some(2), "{other}");
        assert!(text(&output.stderr).contains("cannot be used with"), "{other}");
    }
}
