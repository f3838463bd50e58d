//! The whole pipeline at a small size: it learns, is reproducible, and continues after a stop.

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use progress::Event;

use shared::breath::{DEFAULT_PERIOD_US, PAPER_PIPS, Phase, paper_settings};
use shared::control::Controller;

use super::training::TRAIN;
use super::*;
use crate::controller::Weighting;
use crate::simulator::fit::FIT;
use plant::bench::BenchConfig;
use ventilator::collect::COLLECT;
use ventilator::{BenchSource, Tick};

fn small() -> PipelineConfig {
    let mut config = PipelineConfig { rounds: 2, ensemble: 1, ..PipelineConfig::default() };
    config.collect.breaths = 24;
    config.fit.epochs = 60;
    config.train.iterations = 40;
    config.train.batch = 32;
    config.train.validate_every = 10;
    config
}

fn source(config: &PipelineConfig) -> impl Fn(u64) -> Result<Box<dyn Source>, SourceError> + use<> {
    let (settings, period_us) = (config.collect.settings, config.period_us);
    let base = config.collector::<Residual>().unwrap();
    move |seed| {
        let lung = BenchConfig::paper(20.0, 20.0);
        Ok(Box::new(BenchSource::new(&lung, base.clone(), &settings, period_us, seed)?))
    }
}

fn run_small(folder: Option<&Path>, progress: &Progress<'_>) -> Result<Outcome, PipelineError> {
    let (config, folder) = (small(), folder.map(Workspace::new));
    let folder = folder.as_ref().map(|workspace| RunFolder { workspace, plants: vec![json!("R20C20")] });
    run(&config, &[&source(&config)], folder, progress)
}

/// Mean true |p - target| over the inspirations of the paper's waveforms, under noise not used in learning.
pub(super) fn score(lung: &BenchConfig, controller: &Controller) -> f32 {
    let mut errors = Vec::new();
    for seed in ventilator::seeds::evaluation(3) {
        for settings in PAPER_PIPS.map(paper_settings) {
            let mut source =
                BenchSource::new(lung, controller.clone(), &settings, DEFAULT_PERIOD_US, seed).unwrap();
            for breath in 0..3 {
                let mut sink = |tick: &Tick| {
                    if breath > 0 && tick.sample.phase == Phase::Inspiration {
                        errors.push((tick.truth.unwrap().airway_pressure - tick.sample.target).abs());
                    }
                };
                source.breath(&settings, &mut sink).unwrap();
            }
        }
    }
    errors.iter().sum::<f32>() / errors.len() as f32
}

fn whole(folder: Option<&Path>) -> Outcome {
    run_small(folder, &Progress::silent()).unwrap()
}

#[test]
fn the_learned_controller_beats_its_pid_on_the_true_bench() {
    let outcome = whole(None);
    assert_eq!((outcome.rounds.len(), outcome.complete), (2, true));
    let lung = BenchConfig::paper(20.0, 20.0);
    let (pid, learned) = (
        score(&lung, &small().collector::<Residual>().unwrap()),
        score(&lung, &Controller::Residual(outcome.learned.controller)),
    );
    assert!(learned < 0.7 * pid, "learned {learned:.3}, PID {pid:.3}");
}

#[test]
fn the_same_seed_gives_the_same_controller_on_any_number_of_threads() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| whole(None).learned)
    };
    assert_eq!(on(1), on(2));
}

#[test]
fn a_stopped_run_goes_on_as_if_it_had_not_been_stopped() {
    let folders = tempfile::tempdir().unwrap();
    let (straight, stopped) = (folders.path().join("straight"), folders.path().join("stopped"));
    let expected = whole(Some(&straight));
    for (stop_round, stop_stage, stop_at) in
        [(0, COLLECT, 3), (0, FIT, 5), (0, TRAIN, 20), (1, FIT, 2), (1, TRAIN, 10)]
    {
        let stop = AtomicBool::new(false);
        let observer = |event: &Event<'_>| {
            if (event.round, event.stage) == (Some(stop_round), stop_stage) && event.done >= stop_at {
                stop.store(true, Ordering::Relaxed);
            }
        };
        match run_small(Some(&stopped), &Progress::new(&observer, &stop)) {
            Ok(outcome) => assert!(!outcome.complete),
            Err(error) => assert!(matches!(error, PipelineError::Stopped), "{error}"),
        }
    }
    let resumed = whole(Some(&stopped));
    assert_eq!(resumed.learned, expected.learned);
    for name in ["recording-0.parquet", "simulator-0-0.safetensors", "controller.safetensors"] {
        let file = |folder: &Path| fs::read(folder.join("round-1").join(name)).unwrap();
        assert!(file(&straight) == file(&stopped), "{name} differs");
    }
}

#[test]
fn one_controller_learns_from_several_plants() {
    let mut config = PipelineConfig { rounds: 1, ..small() };
    config.train.weighting = Weighting::Softmax(0.5);
    let lungs = [BenchConfig::paper(20.0, 20.0), BenchConfig::paper(50.0, 10.0)];
    let base = config.collector::<Residual>().unwrap();
    let make = |lung: usize, seed| -> Result<Box<dyn Source>, SourceError> {
        let (settings, period_us) = (config.collect.settings, config.period_us);
        Ok(Box::new(BenchSource::new(&lungs[lung], base.clone(), &settings, period_us, seed)?))
    };
    let (first, second) = (|seed| make(0, seed), |seed| make(1, seed));
    let both: Outcome = run(&config, &[&first, &second], None, &Progress::silent()).unwrap();
    let alone: Outcome = run(&config, &[&first], None, &Progress::silent()).unwrap();
    assert_eq!(both.plants.len(), 2);
    assert_eq!(both.plants[0].recording, alone.plants[0].recording, "a plant does not depend on the others");
    assert_ne!(both.plants[0].recording.u_in, both.plants[1].recording.u_in);
    assert_eq!((both.rounds[0].breaths, both.rounds[0].open_loop.len()), (48, 4));
    let controller = Controller::Residual(both.learned.controller);
    for lung in &lungs {
        let (pid, learned) = (score(lung, &base), score(lung, &controller));
        assert!(learned < 0.95 * pid, "{}: learned {learned:.3}, PID {pid:.3}", lung.name);
    }
}

#[test]
fn a_folder_of_another_run_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    whole(Some(folder.path()));
    let workspace = &Workspace::new(folder.path());
    for (config, plant, difference) in [
        (PipelineConfig { seed: 2, ..small() }, "R20C20", "`seed` is 1 there and 2 here"),
        (small(), "R5C50", "`plants` is \"R20C20\" there and \"R5C50\" here"),
    ] {
        let folder = RunFolder { workspace, plants: vec![json!(plant)] };
        let result = run::<Residual>(&config, &[&source(&config)], Some(folder), &Progress::silent());
        let refused = result.map(|_| ()).unwrap_err();
        assert!(matches!(refused, PipelineError::Workspace(WorkspaceError::OtherRun { .. })));
        assert!(refused.to_string().contains(difference), "{refused}");
    }
}

#[test]
fn a_training_that_does_not_help_ends_with_the_pid() {
    let mut config = PipelineConfig { rounds: 1, ..small() };
    // Steps large enough to ruin the network immediately.
    config.train.adam.rate = 1.0e2;
    config.train.iterations = 4;
    config.train.validate_every = 4;
    let outcome: Outcome = run(&config, &[&source(&config)], None, &Progress::silent()).unwrap();
    assert!(!outcome.rounds[0].improved);
    assert!(outcome.learned.controller.network().parameters().all(|weight| weight.to_bits() == 0));
}
