//! The rivals of the learned controllers in the commands that take a controller.

use super::support::Place;

const NAMES: [&str; 4] = ["variable-gain", "iterative", "feed-forward", "gated"];

#[test]
fn the_help_of_each_command_that_takes_a_controller_names_the_rivals() {
    let place = Place::new();
    for command in ["evaluate", "robust", "margins", "tune-rival"] {
        let help = place.ok(&format!("{command} --help"));
        assert!(NAMES.iter().all(|name| help.contains(name)), "{command}: {help}");
    }
}

#[test]
fn each_rival_is_scored_beside_a_pid_without_typed_gains() {
    let place = Place::new();
    for name in NAMES {
        let result = place
            .json(&format!("evaluate --controller {name} --pips 15 --breaths 1 --breaths-of-learning 2"));
        assert_eq!(result["controller"], name);
        let score = |which: &str| result["mean"][which]["score"].as_f64().unwrap();
        assert!(score("learned") < 3.0 && (score("learned") - score("pid")).abs() > 1e-6, "{name}");
        let result = place.json(&format!("robust --plants 2 --breaths 1 --subset 0 --controller {name}"));
        assert!(
            (result["mean"][0].as_f64().unwrap() - result["family_pid"][0].as_f64().unwrap()).abs() > 1e-6
        );
    }
}

#[test]
fn the_margins_of_iterative_learning_come_with_the_certificate_of_its_own_rule() {
    let result = Place::new().json("margins --controller iterative");
    assert!(result["learning"]["worst"]["factor"].is_number(), "{result}");
}

#[test]
fn parameters_of_a_rival_can_be_typed() {
    let place = Place::new();
    let line = "evaluate --pips 15 --breaths 1 --controller variable-gain --parameters";
    let plain = place.json(&format!("{line} 5,200,0.1,0,1"));
    assert_eq!(plain["mean"]["learned"], plain["mean"]["pid"], "without an extra gain it is its PID");
    assert!(place.refused(&format!("{line} 5,200")).contains("variable-gain has 5 parameters, not 2"));
    assert!(place.refused(&format!("{line} 5,200,0.1,-1,1")).contains("alpha is -1"));
    let refused = place.refused("evaluate --controller adult --parameters 1,2");
    assert!(refused.contains("--parameters are those of a rival"), "{refused}");
}

#[test]
fn an_unknown_controller_is_answered_with_the_names() {
    let place = Place::new();
    let refused = place.refused("evaluate --controller iterativ");
    assert!(refused.contains("there is no controller iterativ"), "{refused}");
    assert!(refused.contains("adult") && NAMES.iter().all(|name| refused.contains(name)), "{refused}");
    let output = place.run("tune-rival iterativ");
    assert_eq!(output.status.code(), Some(2));
    assert!(super::support::text(&output.stderr).contains(&NAMES.join(", ")));
}

#[test]
fn a_device_and_a_weights_image_refuse_a_rival() {
    let place = Place::new();
    let refused = place.refused("collect --out a.parquet --controller iterative");
    assert!(refused.contains("there is no controller iterative"), "{refused}");
    let refused = place.refused("export feed-forward --out a.bin");
    assert!(refused.contains("there is no controller feed-forward"), "{refused}");
    assert!(!place.path("a.parquet").exists() && !place.path("a.bin").exists());
}

#[test]
fn the_authors_controller_is_trained_scored_and_refused_by_devices() {
    let place = Place::new();
    place.ok("train --controller-architecture authors --rounds 1 --breaths 12 --epochs 20 --iterations 20 --batch 16 --out run");
    let file = "run/controller.safetensors";
    let result = place.json(&format!("evaluate --controller {file} --pips 15 --breaths 1"));
    assert!(result["mean"]["learned"]["score"].is_number(), "{result}");
    let result = place.json(&format!("robust --plants 2 --breaths 1 --subset 0 --controller {file}"));
    assert_eq!(result["plants"], 2);
    let facts = place.ok(&format!("inspect {file}"));
    assert!(facts.contains("authors") && facts.contains("10000"), "{facts}");
    for line in [
        format!("export {file} --out a.bin"),
        format!("flash {file} --port tcp:localhost:1"),
        format!("collect --controller {file} --out a.parquet"),
    ] {
        let refused = place.refused(&line);
        assert!(refused.contains("runs on the host"), "{line}: {refused}");
    }
    assert!(!place.path("a.bin").exists());
    let refused = place.refused("train --error-spacing-us 3000 --out other");
    assert!(refused.contains("--controller-architecture authors"), "{refused}");
}
