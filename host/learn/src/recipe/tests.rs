//! Choices made from a recording, and the breaths held out of the fit.

use super::*;
use crate::simulator::fit_config::{BATCH, STEPS};
use data::identity::LungParameters;
use data::provenance::Provenance;
use data::recording::{Extra, Row};

fn recording(period_us: u32) -> Recording {
    Recording::new(Provenance::new(period_us, "test"), false)
}

fn of(kind: Kind) -> Recipe {
    Recipe { kind: Some(kind), ..Recipe::default() }
}

#[test]
fn the_stitched_architecture_refuses_fast_ticks_and_says_what_to_do() {
    let stitched = of(Kind::Stitched);
    let refused = stitched.architecture(&recording(1_000)).unwrap_err().to_string();
    assert!(refused.contains("--period-us 30000"), "{refused}");
    let theirs = stitched.architecture(&recording(30_000)).unwrap();
    assert_eq!(stitched.config(&theirs, 100).epochs, FitConfig::authors().epochs);
}

#[test]
fn sizes_are_the_models_unless_given() {
    let shape = |recipe: Recipe| match recipe.architecture(&recording(1_000)).unwrap() {
        Architecture::StateSpace(shape) => shape,
        other => panic!("asked for state-space, got {other:?}"),
    };
    assert_eq!(shape(Recipe::default()), StateSpaceConfig::for_period(1_000, 1));
    let small = shape(Recipe { states: Some(3), hidden: Some(4), history: Some(5), ..Recipe::default() });
    assert_eq!((small.states, small.hidden, small.history), (3, 4, 5));
}

#[test]
fn small_recordings_take_more_passes_unless_told_otherwise() {
    let epochs = |recipe: Recipe, breaths| {
        recipe.config(&recipe.architecture(&recording(30_000)).unwrap(), breaths).epochs
    };
    let default = Recipe::default;
    assert_eq!(epochs(default(), 160), STEPS * BATCH / 160);
    assert_eq!(epochs(default(), 3), MOST_EPOCHS);
    assert_eq!(epochs(default(), 100_000), LEAST_EPOCHS);
    assert_eq!(epochs(Recipe { epochs: Some(7), ..default() }, 160), 7);
    assert_eq!(epochs(of(Kind::Stitched), 160), FitConfig::authors().epochs);
}

#[test]
fn without_r_and_c_there_is_no_hybrid() {
    assert_eq!(Recipe::default().kind(&recording(10_000)), Kind::StateSpace);
    let refused = of(Kind::Hybrid).architecture(&recording(10_000)).unwrap_err().to_string();
    assert!(refused.contains("R and C"), "{refused}");
    let extras = [Extra::Resistance, Extra::Compliance];
    let named = Recording::with_extras(Provenance::new(10_000, "test"), &extras);
    assert_eq!(Recipe::default().kind(&named), Kind::Hybrid);
}

#[test]
fn a_recording_without_commands_makes_no_simulator() {
    let mut silent = recording(10_000);
    silent.push(Row::default());
    let refused = Recipe::default().architecture(&silent).unwrap_err();
    assert!(matches!(refused, RecipeError::NoCommands));
    silent.push(Row { tick: 1, u_in: 1.0, ..Row::default() });
    assert!(Recipe::default().architecture(&silent).is_ok());
}

#[test]
fn a_lung_held_out_is_in_no_other_part() {
    let lung = |resistance| LungParameters { resistance, compliance: 20.0 };
    let of = |lung, group| Episode {
        pressure: vec![5.0; 10],
        truth: None,
        commands: vec![0.1; 2],
        rest: vec![0.1; 2],
        start: 5.0,
        plateau: 5.0,
        phases: [1.0, 2.0],
        plateau_command: 0.1,
        pip: 15.0,
        peep: 5.0,
        group: Some(group),
        ventilator: None,
        lung: Some(lung),
        rows: 0..1,
    };
    let all: Vec<Episode> =
        (0..30).map(|n| if n % 3 == 0 { of(lung(5.0), 1) } else { of(lung(20.0), 0) }).collect();
    let holding_out =
        |text: &str| Recipe { hold_out_lungs: vec![text.parse().unwrap()], ..Recipe::default() };
    let groups = ["bench".into(), "ward:2".into()];
    let is_other = |episode: &&Episode| episode.lung == Some(lung(5.0));
    for name in ["5:20", "ward:2"] {
        let recipe = holding_out(name);
        let parts = recipe.parts(&all, &groups).unwrap();
        assert!(!parts.training.iter().chain(&parts.held_out).any(is_other));
        assert_eq!((parts.training.len(), parts.held_out.len(), parts.other_lungs.len()), (16, 4, 10));
    }
    for unknown in ["7:20", "ward:3"] {
        let refused = holding_out(unknown).parts(&all, &groups).unwrap_err().to_string();
        assert!(refused.contains(unknown) && refused.contains("20:20, 5:20, bench, ward:2"), "{refused}");
    }
    let few = Recipe::default().parts(&all[..3], &groups).unwrap_err().to_string();
    assert!(few.contains("3 complete inspirations are too few"), "{few}");
}
