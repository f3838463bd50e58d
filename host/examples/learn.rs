//! The pipeline as a library: from a bench to a weights image in a few lines.
//!
//! Run with `cargo run --release --example learn -p host`. It records a stiff lung with a cautious PI, learns a
//! controller in two rounds, compares both on the true bench and writes `out/learn/weights.bin`.

use std::path::Path;

use data::files::write_atomically;
use learn::pipeline::{self, Outcome, PipelineConfig};
use plant::bench::BenchConfig;
use progress::Progress;
use score::evaluate::{Plan, evaluate};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use ventilator::{BenchSource, Source};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // R 50 cmH2O/(L/s), C 10 mL/cmH2O; any parameter of the bench can be changed here.
    let bench = BenchConfig::paper(50.0, 10.0);
    let mut config = PipelineConfig { rounds: 2, ..PipelineConfig::default() };
    config.gains = PidGains { p: 1.0, i: 15.0, d: 0.0 };
    config.fit.epochs = 600;
    config.train.iterations = 300;

    // A source is a whole ventilator; here its lung is virtual. Each round requests a new one.
    let pid = Controller::Pid(Pid::new(config.gains, config.period_us)?);
    let (settings, period_us) = (config.collect.settings, config.period_us);
    let source = |seed| {
        let source = BenchSource::new(&bench, pid.clone(), &settings, period_us, seed)?;
        Ok(Box::new(source) as Box<dyn Source>)
    };

    // No folder to continue from, no observer, never stopped.
    let outcome: Outcome = pipeline::run(&config, &[&source], None, &Progress::silent())?;

    let plan = Plan::evaluation(config.seed);
    let learned = Controller::Residual(outcome.learned.controller.clone());
    for (name, controller) in [("PID", &pid), ("learned", &learned)] {
        let mean = evaluate(&bench, controller, &plan)?.mean;
        println!("{name:<8} error {:.3} cmH2O, overshoot {:.2} cmH2O", mean.score, mean.overshoot);
    }
    write_atomically(Path::new("out/learn/weights.bin"), &outcome.learned.image()?)?;
    Ok(())
}
