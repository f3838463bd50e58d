//! From a recording to a packed controller, at a tiny size.

use std::fmt::Write;

use data::recording::Recording;
use learn::controller::learned::Learned;
use learn::simulator::model::Simulator;
use shared::weights::decode;

use super::support::Place;

#[test]
fn a_collection_is_a_valid_recording_and_the_same_for_the_same_seed() {
    let place = Place::new();
    let summary = place.json("collect --out a.parquet --breaths 6 --seed 3");
    place.ok("collect --out b.parquet --breaths 6 --seed 3");
    place.ok("collect --out c.parquet --breaths 6 --seed 4");
    let recording = Recording::load(place.path("a.parquet")).unwrap();
    assert_eq!(recording.inspirations().len(), 6);
    assert_eq!((&summary["breaths"], &summary["ticks"]), (&6.into(), &recording.len().into()));
    assert_eq!(recording.provenance.seed, 3);
    let bytes = |name: &str| std::fs::read(place.path(name)).unwrap();
    assert_eq!(bytes("a.parquet"), bytes("b.parquet"));
    assert_ne!(bytes("a.parquet"), bytes("c.parquet"));
}

#[test]
fn a_learned_controller_that_collects_is_named_in_the_recording() {
    let place = Place::new();
    let controller = place.controller();
    let packed = place.json(&format!("export {controller} --out weights.bin"));
    place.ok(&format!("collect --out a.parquet --breaths 2 --controller {controller} --exploration none"));
    let recording = Recording::load(place.path("a.parquet")).unwrap();
    assert_eq!(packed["id"], recording.provenance.weights_id.as_str());
    assert!(recording.explore.iter().all(|explore| *explore == 0.0));
}

#[test]
fn a_simulator_is_fitted_judged_and_reported() {
    let place = Place::new();
    let data = place.collected();
    let line = format!("fit {data} {data} --out sim.safetensors --epochs 3 --states 4 --hidden 4");
    let summary = place.json(&format!("{line} --report fit.html"));
    assert_eq!((&summary["training_breaths"], &summary["held_out_breaths"]), (&20.into(), &4.into()));
    assert!(summary["open_loop_true"].as_f64().unwrap() > 0.0);
    let simulator = Simulator::load(&place.path("sim.safetensors")).unwrap();
    assert_eq!(summary["parameters"], simulator.parameters.len());
    let report = std::fs::read_to_string(place.path("fit.html")).unwrap();
    for text in [
        "Training curve",
        "open loop",
        ">simulator - true pressure<",
        "out sim.safetensors --epochs 3 --states 4",
    ] {
        assert!(report.contains(text), "{text}");
    }
    assert!(
        report.contains("<pre class=\"command\">trainer train --simulator sim.safetensors"),
        "what to do next"
    );
    // The note on the second recording, in words.
    assert!(report.contains("are another recording") && !report.contains("weights none"));
    assert!(place.ok("inspect sim.safetensors").contains("learned simulator"));
}

#[test]
fn a_learned_controller_is_scored_beside_its_pid() {
    let place = Place::new();
    let controller = place.controller();
    let small = "--pips 15,25 --breaths 1 --seed 5";
    let alone = place.json(&format!("evaluate --gains 3,30 {small}"));
    let both = place.json(&format!("evaluate --controller {controller} {small} --report evaluation.html"));
    let other = place.json(&format!("evaluate --controller {controller} --against 2,50 {small}"));
    assert_eq!(alone["waveforms"][0]["pid"], both["waveforms"][0]["pid"], "same gains, same noise");
    assert!(alone["waveforms"][0].get("learned").is_none());
    assert_ne!(both["mean"]["pid"]["score"], both["mean"]["learned"]["score"]);
    assert_ne!(both["mean"]["pid"]["score"], other["mean"]["pid"]["score"]);
    assert_eq!(both["mean"]["learned"], other["mean"]["learned"]);
    assert_eq!((&both["seed"], &both["lung"]), (&5.into(), &"R20C20".into()));
    for figure in ["score", "rise_ms", "overshoot", "plateau_error"] {
        assert!(both["waveforms"][1]["learned"][figure].is_number(), "{figure}");
    }
    let report = std::fs::read_to_string(place.path("evaluation.html")).unwrap();
    let export = format!("trainer export {controller} --out weights.bin");
    let made = format!("trainer evaluate --controller {controller} {small} --report evaluation.html");
    for text in ["Inspiratory valve", "This command made the page, in ", &export, &made] {
        assert!(report.contains(text), "{text}");
    }
}

/// A bench with these lines in its table of the patient, written to a file.
fn bench_of_patient(place: &Place, patient: &str) -> &'static str {
    std::fs::write(place.path("patient.toml"), format!("name = \"breathing\"\n[patient]\n{patient}"))
        .unwrap();
    "patient.toml"
}

#[test]
fn breathing_patients_end_with_a_table_and_a_recording() {
    let place = Place::new();
    let controller = place.controller();
    for effort in
        ["effort_cmh2o = 3.0\neffort_rate_per_min = 21.0", "effort_cmh2o = 12.0", "cough_cmh2o = 30.0"]
    {
        let bench = bench_of_patient(&place, effort);
        let line = format!("--bench {bench} --controller {controller}");
        let text = place.ok(&format!("evaluate {line} --pips 15,30"));
        assert!(text.contains("PIP 15") && text.contains("mean"), "{effort}: {text}");
        let recorded =
            place.json(&format!("collect {line} --out breaths.parquet --breaths 8 --seed 2 --force"));
        assert_eq!(recorded["breaths"], 8, "{effort}: {recorded}");
    }
}

#[test]
fn triggered_breaths_are_scored_beside_timed_ones() {
    let place = Place::new();
    let controller = place.controller();
    let line = format!("evaluate --controller {controller} --breathing --pips 20 --breaths 3");
    let scores = place.json(&line);
    assert_eq!(scores["controllers"], serde_json::json!(["PID", "learned"]));
    assert_eq!(scores["patients"].as_array().unwrap().len(), 3);
    for kind in ["passive", "timed", "triggered"] {
        let mean = |n: usize| scores["mean"][n][kind].as_f64().unwrap();
        assert!(mean(0) > 0.3 && (mean(0) - mean(1)).abs() > 1e-6, "{kind}: {scores}");
    }
    let table = place.ok(&line);
    assert!(table.contains("/ timed") && table.contains("R20C20"), "{table}");
    let passive = place.json(&format!("evaluate --controller {controller} --pips 20 --breaths 3"));
    let difference = passive["mean"]["learned"]["score"].as_f64().unwrap()
        - scores["mean"][1]["passive"].as_f64().unwrap();
    assert!(difference.abs() < 1e-9, "{difference}");
}

#[test]
fn a_packed_controller_is_the_same_controller() {
    let place = Place::new();
    let controller = place.controller();
    place.ok(&format!("export {controller} --out weights.bin"));
    let image = decode(&std::fs::read(place.path("weights.bin")).unwrap()).unwrap();
    assert_eq!(image.residual, Learned::load(&place.path(controller)).unwrap().controller);
    let facts = place.ok("inspect weights.bin");
    assert!(facts.contains(&format!("{:08x}", image.id)) && facts.contains("seed 9"), "{facts}");
    let score =
        |line: &str| place.json(&format!("evaluate {line} --pips 20 --breaths 1"))["mean"]["learned"].clone();
    assert_eq!(score("--controller weights.bin"), score(&format!("--controller {controller}")));
}

#[test]
fn the_best_pid_is_searched_and_mapped() {
    let place = Place::new();
    let result = place.json("tune-pid --grid authors --breaths 1 --pips 20 --report tuned.html");
    let best = &result["lungs"][0]["best"];
    assert!(best["pi"]["score"].as_f64().unwrap() <= best["p_only"]["score"].as_f64().unwrap());
    assert_eq!(result["complete"], true);
    assert!(std::fs::read_to_string(place.path("tuned.html")).unwrap().contains("mean absolute error"));
}

/// Two breaths at 100 Hz in the layout of the `RespiraWorks` tables.
fn table() -> String {
    let mut table = "run,test,C_ml_per_cmH2O,R_cmH2O_per_Lps,t_s,setpoint_cmH2O,pressure_cmH2O,flow_in_mlps,\
                     flow_out_mlps,cmd_inh_valve,cmd_exh_valve,cmd_psol\n"
        .to_owned();
    for row in 0..800 {
        let up = (50..150).contains(&(row % 300));
        let (pressure, inhale) = if up { (20.0, 0.6) } else { (5.0, 0.1) };
        let time = f64::from(row) * 0.01;
        writeln!(table, "CT_AIR,1,50,5,{time:.3},{pressure},{pressure},300,200,{inhale},0.4,0.0").unwrap();
    }
    table
}

#[test]
fn measured_tables_become_a_recording() {
    let place = Place::new();
    std::fs::write(place.path("table.csv"), table()).unwrap();
    let summary = place.json("import table.csv --out table.parquet");
    assert_eq!(summary["rows"], 800);
    let recording = Recording::load(place.path("table.parquet")).unwrap();
    assert_eq!(summary["complete_breaths"], recording.inspirations().len());
    assert!(place.ok("inspect table.parquet").contains("CT_AIR:1"));
}

#[test]
fn a_controller_is_trained_in_rounds_and_a_second_call_finds_it_done() {
    let place = Place::new();
    let line = "train --out run --rounds 1 --breaths 12 --epochs 20 --iterations 10 --batch 16 --seed 2";
    let first = place.json(line);
    assert_eq!((&first["rounds"][0]["breaths"], &first["complete"]), (&12.into(), &true.into()));
    assert!(first["validation"].as_f64().unwrap() <= first["base"].as_f64().unwrap());
    let learned = Learned::load(&place.path("run/controller.safetensors")).unwrap();
    assert_eq!((learned.origin.seed, learned.origin.plant.as_str()), (2, "R20C20"));
    assert_eq!(place.json(line), first);
}

#[test]
fn a_controller_is_trained_on_simulators_already_fitted() {
    let place = Place::new();
    let data = place.collected();
    for seed in [1, 2] {
        place.ok(&format!("fit {data} --out {seed}.safetensors --epochs 30 --seed {seed}"));
    }
    let line = "train --simulator 1.safetensors 2.safetensors --iterations 10 --batch 16 --out once";
    let summary = place.json(line);
    assert!(summary["train_curve"].as_array().is_some_and(|curve| !curve.is_empty()));
    Learned::load(&place.path("once/controller.safetensors")).unwrap();
    assert_eq!(place.json(line), summary, "a second call finds it done");
    for (other, what) in [
        ("--seed 2", "`seed` is 1 there and 2 here; choose another folder"),
        ("--lambda 0.5", "`lambda` is 1.0 there and 0.5 here; choose another folder"),
    ] {
        let refused = place.refused(&format!("{line} {other}"));
        assert!(refused.contains("once belongs to another run: ") && refused.contains(what), "{refused}");
    }
    let twice = place.refused("train --simulator 1.safetensors ./1.safetensors --out twice");
    assert!(twice.contains("the same simulator"), "{twice}");
    let alone = place.ok("train --simulator 1.safetensors --iterations 10 --batch 16 --out alone");
    assert!(alone.contains("its own simulator") && !alone.contains("held-out"), "{alone}");
}

#[test]
fn a_pid_learns_nothing_in_the_breaths_before_the_scored_ones() {
    let place = Place::new();
    let score = |line: &str| {
        let result = place.json(&format!("evaluate --gains 3,30 --pips 20 --breaths 2 {line}"));
        (result["mean"]["pid"]["score"].as_f64().unwrap(), result["breaths_of_learning"].as_u64().unwrap())
    };
    let (plain, one) = score("");
    assert_eq!((one, score("--breaths-of-learning 1").0.to_bits()), (1, plain.to_bits()));
    let (from_rest, none) = score("--breaths-of-learning 0");
    assert!(none == 0 && from_rest.to_bits() != plain.to_bits(), "the breath from rest counts");
    let (late, breaths) = score("--breaths-of-learning 12 --report late.html");
    assert!(breaths == 12 && late.to_bits() != plain.to_bits(), "other breaths have other noise");
    assert!((late / plain - 1.0).abs() < 0.05, "{late}, {plain}");
}
