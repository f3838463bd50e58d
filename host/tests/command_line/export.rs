//! `trainer export`: ONNX files of controllers and simulators, and what they compute.

use super::support::Place;

/// The JSON in a file.
fn read(place: &Place, name: &str) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(place.path(name)).unwrap()).unwrap()
}

#[test]
fn a_controller_is_exported_with_the_steps_of_ten_lessons() {
    let place = Place::new();
    let controller = place.controller();
    let summary = place.json(&format!("export {controller} --out a.onnx --check a.json"));
    let bytes = std::fs::read(place.path("a.onnx")).unwrap();
    assert_eq!((&summary["kind"], &summary["period_us"]), (&"controller".into(), &1000.into()));
    assert_eq!(summary["bytes"], bytes.len());
    let steps = read(&place, "a.json");
    let lessons = steps.as_array().unwrap().iter().filter(|step| step["commands"].is_null());
    assert_eq!(lessons.count(), 10);
    place.ok(&format!("export {controller} --out b.onnx"));
    assert_eq!(std::fs::read(place.path("b.onnx")).unwrap(), bytes);
    place.ok("export adult --out adult.onnx");
    assert_ne!(std::fs::read(place.path("adult.onnx")).unwrap(), bytes);
}

#[test]
fn a_simulator_is_exported_with_a_breath() {
    let place = Place::new();
    let data = place.collected();
    assert!(place.ok(&format!("fit {data} --epochs 3")).contains("the simulator is not kept: --out"));
    place.ok(&format!("fit {data} --epochs 3 --out a.safetensors"));
    let said = place.ok("export a.safetensors --out a.onnx --check a.json");
    assert!(said.contains("saved a.onnx: simulator, ") && said.contains("saved a.json"), "{said}");
    let breath = read(&place, "a.json");
    assert_eq!(
        (breath["block_ticks"].as_u64(), breath["commands"].as_array().unwrap().len()),
        (Some(10), 1000)
    );
}

#[test]
fn what_cannot_be_exported_is_refused() {
    let place = Place::new();
    let (controller, data) = (place.controller(), place.collected());
    let told = place.refused(&format!("export {controller} --out a.onnx --unit 1"));
    assert!(told.contains("omit it"), "{told}");
    assert!(place.refused(&format!("export {data} --out a.onnx")).contains("not a valid"));
    assert!(place.refused("export missing.safetensors --out a.onnx").contains("missing.safetensors"));
    assert!(place.refused("export iterative --out a.onnx").contains("there is no controller iterative"));
    place.ok(&format!("fit {data} --epochs 3 --out a.safetensors"));
    let told = place.refused("export a.safetensors --out a.onnx --unit 1");
    assert!(told.contains("it has 1, numbered from 0"), "{told}");
    assert!(!place.path("a.onnx").exists());
}
