//! What of the command can be told without a process.

use super::*;
use crate::provenance::Provenance;

fn episode(pip: f32, group: Option<u32>) -> Episode {
    Episode {
        pressure: vec![5.0; 10],
        truth: None,
        commands: vec![0.1; 2],
        rest: vec![0.1; 2],
        start: 5.0,
        plateau: 5.0,
        plateau_command: 0.1,
        pip,
        peep: 5.0,
        group,
        lung: None,
        rows: 0..10,
    }
}

#[test]
fn random_pips_are_no_waveforms() {
    let all = [episode(10.0, None), episode(13.7, None), episode(10.0, None)];
    let found = repeated(&all.iter().collect::<Vec<_>>());
    assert_eq!(found.len(), 2);
    assert!(found.iter().all(|e| e.pip.total_cmp(&10.0).is_eq()));
}

fn recording(period_us: u32) -> Recording {
    Recording::new(Provenance::new(period_us, "test"), false)
}

fn args(arguments: &[&str]) -> Args {
    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }
    let line = ["fit", "--data", "a", "--out", "b"].iter().chain(arguments);
    <Line as clap::Parser>::try_parse_from(line).unwrap().args
}

#[test]
fn the_stitched_architecture_refuses_fast_ticks_and_says_what_to_do() {
    let stitched = args(&["--architecture", "stitched"]);
    let refused = architecture(&stitched, &recording(1_000)).unwrap_err().to_string();
    assert!(refused.contains("--period-us 30000"), "{refused}");
    assert!(architecture(&stitched, &recording(30_000)).is_ok());
}

#[test]
fn the_papers_preset_takes_its_simulator_and_refuses_other_recordings() {
    let preset = args(&["--preset", "paper-30ms"]);
    let theirs = architecture(&preset, &recording(30_000)).unwrap();
    assert!(matches!(theirs, Architecture::Stitched(_)));
    assert_eq!(config(&preset, &theirs, 100).epochs, FitConfig::authors().epochs);
    let ours = args(&["--preset", "paper-30ms", "--architecture", "state-space"]);
    assert!(matches!(architecture(&ours, &recording(30_000)).unwrap(), Architecture::StateSpace(_)));
    let check = |recording: &Recording| preset.preset.unwrap().check(recording);
    assert!(check(&recording(30_000)).is_ok());
    assert!(check(&recording(1_000)).unwrap_err().to_string().contains("--period-us 30000"));
    let mut high = recording(30_000);
    high.push(crate::dataset::Row { peep: 8.0, ..crate::dataset::Row::default() });
    assert!(check(&high).unwrap_err().to_string().contains("PEEP 8"));
}

#[test]
fn sizes_are_the_models_unless_given() {
    let shape = |arguments: &[&str]| match architecture(&args(arguments), &recording(1_000)).unwrap() {
        Architecture::StateSpace(shape) => shape,
        other => panic!("asked for state-space, got {other:?}"),
    };
    assert_eq!(shape(&[]), StateSpaceConfig::for_period(1_000, 1));
    let small = shape(&["--states", "3", "--hidden", "4", "--history", "5"]);
    assert_eq!((small.states, small.hidden, small.history), (3, 4, 5));
}

#[test]
fn small_recordings_take_more_passes_unless_told_otherwise() {
    let epochs = |arguments: &[&str], breaths| {
        let args = args(arguments);
        config(&args, &architecture(&args, &recording(30_000)).unwrap(), breaths).epochs
    };
    assert_eq!(epochs(&[], 160), STEPS * BATCH / 160);
    assert_eq!(epochs(&[], 3), MOST_EPOCHS);
    assert_eq!(epochs(&[], 100_000), LEAST_EPOCHS);
    assert_eq!(epochs(&["--epochs", "7"], 160), 7);
    assert_eq!(epochs(&["--architecture", "stitched"], 160), FitConfig::authors().epochs);
}
