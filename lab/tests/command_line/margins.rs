//! `lab margins`, on one lung.

use super::support::Place;

#[test]
fn a_pid_has_margins_at_six_points_the_same_for_the_same_seed() {
    let place = Place::new();
    let line = "margins --gains 3,30 --learning 2,50,15 --plot nyquist.svg --learning-plot learning.svg";
    let result = place.json(line);
    let plant = &result["plants"][0];
    assert_eq!(plant["plant"], "R20C20");
    let points = plant["points"].as_array().unwrap();
    assert_eq!(points.len(), 6);
    let worst = points.iter().map(|point| point["margins"]["ms"].as_f64().unwrap()).fold(0.0, f64::max);
    assert_eq!(result["worst"]["ms"].as_f64(), Some(worst));
    assert_eq!(points[0]["response"][0]["loop"].as_array().map(Vec::len), Some(2));
    assert_eq!(result["accuracy"].as_array().map(Vec::len), Some(4));
    assert!(result["learning"]["worst"]["factor"].is_number() && result["residual"].is_null());
    for figure in ["nyquist.svg", "learning.svg"] {
        assert!(std::fs::read_to_string(place.path(figure)).unwrap().starts_with("<svg"), "{figure}");
    }
    assert_eq!(result, place.json(line));
}

#[test]
fn a_learned_controller_is_measured_beside_its_pid_with_the_gain_of_its_residual() {
    let place = Place::new();
    let controller = place.controller();
    let text = place.ok(&format!("margins --controller {controller}"));
    assert!(text.contains("PID alone, 35"), "{text}");
    // The network of this controller ignores its inputs.
    assert!(text.contains("to the pressure, %/cmH2O: 0.00"), "{text}");
    assert!(place.refused("margins --family aliens").contains("there is no family aliens"));
}

#[test]
fn iterative_learning_is_certified_plant_by_plant_on_a_family() {
    let line = "margins --family adult --plants 2 --seed 3 --controller iterative --learning-plot all.svg";
    let place = Place::new();
    let result = place.json(line);
    assert_eq!(result["learning"]["share_certified"], 1.0);
    let plants = result["learning"]["plants"].as_array().unwrap();
    let largest = plants.iter().map(|plant| plant["worst"]["factor"].as_f64().unwrap()).fold(0.0, f64::max);
    assert_eq!((plants.len(), result["learning"]["worst"]["factor"].as_f64()), (2, Some(largest)));
    let figure = std::fs::read_to_string(place.path("all.svg")).unwrap();
    assert!(["median of the plants", "95 %", "largest"].iter().all(|name| figure.contains(name)));
}

#[test]
fn the_shipped_controller_for_adults_keeps_the_margins_on_all_nominal_lungs() {
    let result = Place::new().json("margins --bench paper --controller adult");
    assert_eq!(result["share_robust"], 1.0, "{}", result["worst"]);
}

#[test]
fn plants_are_measured_at_the_plateau_of_a_prescription_each() {
    let place = Place::new();
    let line = "margins --family adult --plants 2 --prescriptions bedside --gains 3,30 --seed 3";
    let result = place.json(line);
    assert_eq!(result["prescriptions"], "bedside");
    let plants = result["plants"].as_array().unwrap();
    let peeps: Vec<f64> = plants
        .iter()
        .map(|plant| {
            let points = plant["points"].as_array().unwrap();
            assert_eq!(points.len(), 1);
            points[0]["peep"].as_f64().unwrap()
        })
        .collect();
    assert!(peeps[0].to_bits() != peeps[1].to_bits(), "{peeps:?}");
}

#[test]
fn margins_measured_in_breaths_stand_beside_the_exact_ones() {
    let place = Place::new();
    let result = place.json("margins-in-breaths --bench R20C20 --gains 4,120,0.1");
    let (plant, found) = (&result["plants"][0], &result["plants"][0]["gain_margin"]["found"]["found"]);
    let exact = plant["gain_margin"]["exact"].as_f64().unwrap();
    assert!((found["value"].as_f64().unwrap() / exact - 1.0).abs() < 0.1, "{plant}");
    let text = place.ok("margins-in-breaths --bench R20C20 --gains 4,120,0.1");
    assert!(text.contains("gain margin: 1 of 1 agree"), "{text}");
}
