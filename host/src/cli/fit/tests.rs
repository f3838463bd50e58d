//! What of the command can be told without a process.

use super::*;
use data::import::{measured, measured_recording};
use data::provenance::Provenance;
use data::recording::Extra;

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
        ventilator: None,
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
    high.push(data::recording::Row { peep: 8.0, ..data::recording::Row::default() });
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

#[test]
fn without_r_and_c_there_is_no_hybrid() {
    assert_eq!(kind(&args(&[]), &recording(10_000)), Kind::StateSpace);
    let refused =
        architecture(&args(&["--architecture", "hybrid"]), &recording(10_000)).unwrap_err().to_string();
    assert!(refused.contains("R and C"), "{refused}");
    let extras = [Extra::Resistance, Extra::Compliance];
    let named = Recording::with_extras(Provenance::new(10_000, "test"), &extras);
    assert_eq!(kind(&args(&[]), &named), Kind::Hybrid);
}

#[test]
fn a_lung_held_out_is_in_no_lesson_and_in_no_other_part() {
    let lung = |resistance| LungParameters { resistance, compliance: 20.0 };
    let of = |lung, group| Episode { lung: Some(lung), rows: 0..1, ..episode(15.0, Some(group)) };
    let all: Vec<Episode> =
        (0..30).map(|n| if n % 3 == 0 { of(lung(5.0), 1) } else { of(lung(20.0), 0) }).collect();
    let args = args(&["--hold-out-lung", "5:20"]);
    let parts = Parts::new(&args, &all).unwrap();
    let is_other = |episode: &&Episode| episode.lung == Some(lung(5.0));
    assert!(!parts.training.iter().chain(&parts.held_out).any(is_other));
    assert_eq!((parts.training.len(), parts.held_out.len(), parts.other_lungs.len()), (16, 4, 10));
    let refused = Parts::new(&self::args(&["--hold-out-lung", "7:7"]), &all).err().unwrap().to_string();
    assert!(refused.contains("5:20, 20:20") || refused.contains("20:20, 5:20"), "{refused}");
}

/// A quarter of the default's training has to do; `docs/RECORDINGS.md` has the command for all of it.
#[test]
fn one_simulator_of_measured_lungs_beats_classical_identification_and_holds_on_lungs_it_never_saw() {
    let Some(paths) = measured() else { return };
    let folder = tempfile::tempdir().unwrap();
    let recording = measured_recording(&[paths[0].clone(), paths[2].clone()], folder.path());
    let args = args(&["--epochs", "400", "--hold-out-lung", "5:20", "--hold-out-lung", "50:20"]);
    let architecture = architecture(&args, &recording).unwrap();
    assert_eq!(architecture.timing().channels, 1, "the exhale valve follows the inhale valve");
    let all = episodes(&recording, architecture.timing());
    let parts = Parts::new(&args, &all).unwrap();
    let lessons = lessons(&architecture, &recording, &parts.training);
    let (simulator, curve) =
        fit(&args, architecture, &lessons.iter().collect::<Vec<_>>(), "measured").unwrap();
    let summary = summary(&args, &simulator, &curve, &parts, &recording);
    let (lung, classical) = (summary.open_loop_held_out_lung.unwrap(), summary.classical_open_loop.unwrap());
    println!("held out {} lung {lung} classical {classical} rise {:?}", summary.open_loop, summary.response);
    assert!(
        summary.open_loop < 0.33 && summary.open_loop < 0.5 * classical,
        "{} {classical}",
        summary.open_loop
    );
    assert!(lung < 0.8, "{lung}");
    assert!(
        summary.response.iter().all(|rise| *rise > 0.3),
        "a plant, no controller: {:?}",
        summary.response
    );
}
