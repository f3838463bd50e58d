//! Tests of the command that need no process.

use super::*;
use data::provenance::Provenance;

fn recording(period_us: u32) -> Recording {
    Recording::new(Provenance::new(period_us, "test"), false)
}

fn args(arguments: &[&str]) -> Args {
    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }
    let line = ["fit", "a", "--out", "b"].iter().chain(arguments);
    <Line as clap::Parser>::try_parse_from(line).unwrap().args
}

#[test]
fn the_papers_preset_takes_its_simulator_and_refuses_other_recordings() {
    let preset = args(&["--preset", "paper-30ms"]);
    assert_eq!(recipe(&preset).kind, Some(recipe::Kind::Stitched));
    let ours = args(&["--preset", "paper-30ms", "--architecture", "state-space"]);
    assert_eq!(recipe(&ours).kind, Some(recipe::Kind::StateSpace));
    let check = recipe::check_paper_setting;
    assert!(check(&recording(30_000)).is_ok());
    assert!(check(&recording(1_000)).unwrap_err().to_string().contains("--period-us 30000"));
    let mut high = recording(30_000);
    high.push(data::recording::Row { peep: 8.0, ..data::recording::Row::default() });
    assert!(check(&high).unwrap_err().to_string().contains("PEEP 8"));
}

#[test]
fn what_is_typed_reaches_the_recipe() {
    let open = recipe(&args(&[]));
    assert_eq!((open.kind, open.epochs, open.hold_out), (None, None, Recipe::default().hold_out));
    let line = "--states 3 --hidden 4 --history 5 --batch 6 --epochs 7 --hold-out 8 --seed 9";
    let typed = recipe(&args(&line.split(' ').collect::<Vec<_>>()));
    assert_eq!((typed.states, typed.hidden, typed.history), (Some(3), Some(4), Some(5)));
    assert_eq!((typed.batch, typed.epochs, typed.hold_out, typed.seed), (Some(6), Some(7), 8, 9));
    assert_eq!(recipe(&args(&["--hold-out-lung", "5:20"])).hold_out_lungs, ["5:20".parse().unwrap()]);
}
