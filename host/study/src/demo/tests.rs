//! A small demo: all promised files are written, the same seed gives the same files, and a stopped demo continues.

use std::fs;
use std::path::Path;

use super::*;
use data::recording::Recording;
use learn::controller::learned::Learned;
use learn::simulator::model::Simulator;
use score::baselines::Grid;

fn small(seed: u64) -> DemoConfig {
    let grid = Grid { p: vec![1.0, 4.0], i: vec![15.0, 80.0], d: vec![0.0] };
    let mut pipeline = PipelineConfig { seed, rounds: 1, ensemble: 1, ..PipelineConfig::default() };
    pipeline.collect.breaths = 32;
    pipeline.fit.epochs = 150;
    pipeline.train.iterations = 60;
    pipeline.train.batch = 32;
    pipeline.train.validate_every = 20;
    let search = Search { grid, refinements: 0, exhaustive: true };
    DemoConfig { bench: BenchConfig::paper(20.0, 20.0), search, pipeline, venue: Venue::InProcess }
}

fn run_small(out: &Path, seed: u64) -> Demo {
    run(&small(seed), out, &Progress::silent()).unwrap()
}

#[test]
fn every_file_is_written_and_can_be_read_back() {
    let out = tempfile::tempdir().unwrap();
    let demo = run_small(out.path(), 1);
    let file = |name: &str| out.path().join(name);
    Recording::load(file("recording.parquet")).unwrap().validate().unwrap();
    Simulator::load(&file("simulator.safetensors")).unwrap();
    let learned = Learned::load(&file("controller.safetensors")).unwrap();
    let image = shared::weights::decode(&fs::read(file("weights.bin")).unwrap()).unwrap();
    assert_eq!(image.residual, learned.controller);
    let summary: DemoSummary =
        serde_json::from_str(&fs::read_to_string(file("summary.json")).unwrap()).unwrap();
    assert_eq!(summary, demo.summary);
    assert_eq!(summary.waveforms.len(), 6);
    let html = demo.report().to_html().unwrap();
    for heading in ["Result", "Pressure", "Valves", "Learned simulator", "Training"] {
        assert!(html.contains(&format!(">{heading}<")), "{heading}");
    }
    assert!(
        html.contains("valve effort, %/s")
            && html.matches(">Inspiratory valve, one inspiration</text>").count() == 1
    );
    let error = html.matches(">simulator - true pressure<").count();
    assert_eq!(
        (error, html.contains(">I only</text>")),
        (3, false),
        "errors have figures, rivals a row in a table"
    );
}

#[test]
fn the_same_seed_gives_the_same_table_and_another_seed_another() {
    let folders = tempfile::tempdir().unwrap();
    let table = |name: &str, seed| run_small(&folders.path().join(name), seed).summary.table().to_plain();
    let first = table("a", 1);
    assert_eq!(first, table("b", 1));
    assert_eq!(first, table("a", 1), "going on from a finished run changes nothing");
    assert_ne!(first, table("c", 2));
}
