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
fn a_controller_is_exported_as_c_with_its_header() {
    let place = Place::new();
    let summary = place.json("export adult --out adult.c");
    let [code, header] =
        ["adult.c", "adult.h"].map(|name| std::fs::read_to_string(place.path(name)).unwrap());
    assert_eq!(summary["bytes"], code.len() + header.len());
    assert!(code.contains("#include \"adult.h\"") && header.contains("int adult_self_check("));
    assert!(code.contains(summary["id"].as_str().unwrap()), "the file names its weights");
    // Written again, but over no file of a user, be it the header's.
    place.ok("export neonate --out adult.c");
    assert_ne!(std::fs::read_to_string(place.path("adult.c")).unwrap(), code);
    for name in ["mine.c", "mine.h"] {
        std::fs::write(place.path(name), "/* My own. */\n").unwrap();
        let told = place.wrong("export adult --out mine.c");
        assert!(told.contains(&format!("{name} is a file of another kind, not a controller in C")), "{told}");
        std::fs::remove_file(place.path(name)).unwrap();
    }
    assert!(!place.path("mine.c").exists());
}

#[test]
fn a_controller_that_the_c_file_does_not_know_is_refused_with_the_reason() {
    let place = Place::new();
    let told = place.refused("export adult --out my-controller.c");
    assert!(told.contains("use letters, digits and underscores"), "{told}");
    // As a later version would write it.
    place.ok("export adult --out a.bin");
    let mut image = std::fs::read(place.path("a.bin")).unwrap();
    image[6] += 1;
    let (covered, checksum) = image.split_last_chunk_mut::<4>().unwrap();
    *checksum = shared::checksum::crc32(covered).to_le_bytes();
    std::fs::write(place.path("later.bin"), &image).unwrap();
    let told = place.refused("export later.bin --out a.c");
    assert!(told.contains("image has architecture 4, this version runs 3"), "{told}");
    place.ok(
        "train --controller-architecture authors --rounds 1 --breaths 12 --epochs 3 --iterations 5 --out run",
    );
    let told = place.refused("export run/controller.safetensors --out a.c");
    assert!(told.contains("architecture authors") && told.contains("only ours runs on a device"), "{told}");
    assert!(!place.path("a.c").exists() && !place.path("a.h").exists());
}

#[test]
fn a_controller_is_exported_as_an_fmu_on_a_bench() {
    let place = Place::new();
    let summary = place.json("export adult --out adult.fmu --bench R50C10");
    let bytes = std::fs::read(place.path("adult.fmu")).unwrap();
    assert_eq!((&summary["bench"], &summary["bytes"]), (&"R50C10".into(), &bytes.len().into()));
    place.ok("export adult --out other.fmu");
    assert_ne!(std::fs::read(place.path("other.fmu")).unwrap(), bytes, "another bench");
    std::fs::write(place.path("mine.fmu"), b"PK\x03\x04 an archive of my own").unwrap();
    assert!(place.wrong("export adult --out mine.fmu").contains("is a file of another kind, not an FMU"));
    assert!(place.refused("export adult --out a.c --bench R50C10").contains("--bench is that of an FMU"));
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
