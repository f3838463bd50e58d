//! Third-party plants: the Python example as a separate process, over TCP and over a pipe.
//!
//! These tests need `python3` and nothing else; without it they print so and end.

use std::path::PathBuf;

use data::recording::Recording;
use learn::controller::learned::Learned;

use super::python::{Server, example, json, ok, python_is_there, refused};
use super::support::Place;

/// The Python example.
fn script() -> PathBuf {
    example("plant.py")
}

/// A folder with the example in it, so that its name has no blanks, and the address that starts it.
fn place_with_script() -> (Place, &'static str) {
    let place = Place::new();
    std::fs::copy(script(), place.path("plant.py")).unwrap();
    (place, "pipe:python3\u{a0}plant.py")
}

#[test]
fn the_example_needs_the_standard_library_alone_and_has_less_than_sixty_lines() {
    let source = std::fs::read_to_string(script()).unwrap();
    assert!(source.lines().count() < 60, "{} lines", source.lines().count());
    let imports: Vec<&str> = source.lines().filter(|line| line.contains("import ")).collect();
    assert_eq!(imports, ["import random, socket, struct, sys, zlib"]);
}

#[test]
fn a_plant_in_python_is_recorded_alike_over_tcp_and_over_a_pipe() {
    if !python_is_there() {
        return;
    }
    let (place, pipe) = place_with_script();
    let server = Server::start(&script(), &["0"]);
    let tcp = server.address();
    let summary = json(&place, &format!("collect --plant {tcp} --breaths 6 --seed 3 --out tcp.parquet"));
    assert_eq!((&summary["breaths"], &summary["period_us"]), (&6.into(), &30_000.into()));
    ok(&place, &format!("collect --plant {pipe} --breaths 6 --seed 3 --out pipe.parquet"));
    ok(&place, &format!("collect --plant {tcp} --breaths 6 --seed 3 --out again.parquet"));
    let load = |name: &str| Recording::load(place.path(name)).unwrap();
    let (tcp, pipe) = (load("tcp.parquet"), load("pipe.parquet"));
    assert_eq!(
        (&tcp.pressure, &tcp.u_in, &tcp.pressure_true),
        (&pipe.pressure, &pipe.u_in, &pipe.pressure_true)
    );
    assert_eq!((tcp.len(), tcp.inspirations().len()), (600, 6));
    assert!(tcp.pressure_true.is_some() && tcp.pressure_sensor_true.is_none());
    assert_eq!(load("again.parquet"), tcp, "the server takes one connection after the other");
}

#[test]
fn the_whole_pipeline_runs_on_a_plant_in_python() {
    if !python_is_there() {
        return;
    }
    let (place, plant) = place_with_script();
    let tuned = json(&place, &format!("tune-pid --plant {plant} --grid authors --breaths 1 --pips 20"));
    assert_eq!(tuned["plan"]["period_us"], 30_000);
    let pi = tuned["over_all"]["pi"]["score"].as_f64().unwrap();
    assert!(pi > 0.0 && pi < 5.0, "{pi}");
    ok(&place, &format!("collect --plant {plant} --gains 2,30 --breaths 24 --out a.parquet"));
    let fit = json(&place, "fit a.parquet --epochs 30 --out a.safetensors");
    assert!(fit["open_loop_true"].is_number());
    // The simulator's control period is the controller's.
    ok(&place, "train --simulator a.safetensors --iterations 10 --batch 16 --out once");
    let line = "--gains 2,30 --rounds 1 --breaths 16 --epochs 30 --iterations 10 --batch 16 --out run";
    ok(&place, &format!("train --plant {plant} {line}"));
    let learned = Learned::load(&place.path("run/controller.safetensors")).unwrap();
    assert_eq!(learned.controller.spec().period_us, 30_000);
    let line = "--controller run/controller.safetensors --pips 15,25 --breaths 1";
    let first = json(&place, &format!("evaluate --plant {plant} {line}"));
    assert!(first["mean"]["learned"]["score"].as_f64().unwrap() < 5.0);
    assert_eq!(first["plant"], "pipe:python3 plant.py");
    assert_eq!(json(&place, &format!("evaluate --plant {plant} {line}")), first, "same seed, same scores");
}

#[test]
fn a_plant_that_dies_leaves_what_was_recorded() {
    if !python_is_there() {
        return;
    }
    let (place, plant) = place_with_script();
    let source = std::fs::read_to_string(place.path("plant.py")).unwrap();
    // Hello, Seed, Peep, Reset and 1250 steps: twelve breaths of 100 and half of the next.
    let mortal = source.replace(
        "while len(frame := reader.read(16)) == 16:\n",
        "for _ in range(4 + 1250):\n        frame = reader.read(16)\n",
    );
    assert_ne!(mortal, source);
    std::fs::write(place.path("plant.py"), mortal).unwrap();
    let said = refused(&place, &format!("collect --plant {plant} --breaths 40 --out a.parquet"));
    assert!(said.contains("12 complete breaths are saved in a.parquet"), "{said}");
    assert!(said.contains("gone (exit status: 0)"), "{said}");
    let recording = Recording::load(place.path("a.parquet")).unwrap();
    assert_eq!((recording.len(), recording.inspirations().len()), (1251, 13));
    let line =
        format!("train --plant {plant} --gains 2,30 --rounds 1 --breaths 40 --prescriptions paper --out run");
    let said = refused(&place, &line);
    assert!(said.contains("recording-0.partial.parquet"), "{said}");
    let recording = Recording::load(place.path("run/round-0/recording-0.partial.parquet")).unwrap();
    assert_eq!(recording.len(), 1251);
    assert!(refused(&place, &format!("tune-pid --plant {plant} --grid coarse")).contains("gone"));
    assert!(refused(&place, &format!("evaluate --plant {plant}")).contains("gone"));
}

#[test]
fn a_plant_that_prints_on_its_pipe_is_told_so() {
    if !python_is_there() {
        return;
    }
    let (place, plant) = place_with_script();
    let source = std::fs::read_to_string(place.path("plant.py")).unwrap();
    std::fs::write(place.path("plant.py"), format!("print('a lung of my own', flush=True)\n{source}"))
        .unwrap();
    let said = refused(&place, &format!("collect --plant {plant} --out a.parquet"));
    assert!(said.contains("standard error"), "{said}");
    assert!(!place.path("a.parquet").exists());
}

#[test]
fn another_period_than_the_plants_is_refused() {
    if !python_is_there() {
        return;
    }
    let (place, plant) = place_with_script();
    let controller = place.controller();
    for line in ["collect --out a.parquet", "tune-pid", "train --out run"] {
        let said = refused(&place, &format!("{line} --plant {plant} --period-us 1000"));
        assert!(said.contains("30000 us, not 1000"), "{line}: {said}");
    }
    let said = refused(&place, &format!("evaluate --plant {plant} --controller {controller}"));
    assert!(said.contains("train a controller on the plant"), "{said}");
}

#[test]
fn a_plant_takes_the_place_of_bench_and_port() {
    let place = Place::new();
    for line in [
        "collect --out a.parquet --plant tcp:localhost:7000 --bench R20C20",
        "evaluate --plant tcp:localhost:7000 --port tcp:localhost:5555",
        "train --out run --plant tcp:localhost:7000 --simulator a.safetensors",
        "tune-pid --plant-timeout 5",
        "collect --out a.parquet --plant localhost:7000",
        "collect --out a.parquet --plant tcp:localhost:7000 --plant-timeout 0",
    ] {
        assert_eq!(place.run(line).status.code(), Some(2), "{line}");
    }
}
