//! The authors' balloon, under their conditions: a controller trained only on recordings of it, beside their figures.
//!
//! Run with `cargo run --release --example balloon -p paper`. It records breaths with a cautious PI, learns a simulator
//! and through it a controller, and scores the controller on the balloon itself.

use learn::pipeline::{self, Outcome};
use paper::authors::{self, baseline};
use plant::balloon::PERIOD_US;
use progress::Progress;
use shared::control::Controller;
use shared::control::pid::Pid;
use ventilator::{BalloonSource, Source};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seed = std::env::args().nth(1).map_or(Ok(1), |seed| seed.parse())?;
    let config = authors::pipeline(seed);
    let pid = Controller::Pid(Pid::new(config.gains, PERIOD_US)?);
    let source = |_| Ok(Box::new(BalloonSource::new(pid.clone())) as Box<dyn Source>);
    let outcome: Outcome = pipeline::run(&config, &[&source], None, &Progress::silent())?;
    for (number, round) in outcome.rounds.iter().enumerate() {
        let open_loop = round.open_loop.last().map_or(0.0, |errors| errors.measured);
        println!(
            "round {number}: {} breaths, {} aborted, open-loop distance {open_loop:.3}, held-out simulator {:.3}",
            round.breaths, round.aborts, round.validation
        );
    }
    let learned = Controller::Residual(outcome.learned.controller.clone());
    let best = baseline::best_pi();
    println!("mean |pressure - PIP|, cmH2O");
    println!("  floor: full flow, then an exact hold      {:.3}", baseline::floor());
    println!("  learned from recordings, seed {seed:<11} {:.3}", authors::score(&learned)?);
    println!("  best PI of the authors' grid ({}, {})       {:.3}", best.p, best.i, best.score);
    println!("  the PI that collected                     {:.3}", authors::score(&pid)?);
    Ok(())
}
